use super::*;

#[test]
fn an_environment_without_a_picture_is_refused() {
    let (state, observation) = (vec![0.0], vec![0.0]);
    let frame = Frame { state, observation, scene: None, action: None, q_values: Vec::new() };
    let refused = scenes(std::iter::once(frame), "TwoStates");
    assert!(
        matches!(refused, Err(Failure::BadInput(message)) if message.contains("TwoStates has no picture"))
    );
}
