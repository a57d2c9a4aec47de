use super::*;

#[test]
fn a_long_gradient_is_shortened_and_a_short_one_left_alone() {
    let mut gradient = [3.0, -4.0, 0.0];
    clip_norm(&mut gradient, 5.1);
    assert_eq!(gradient, [3.0, -4.0, 0.0]);
    // 3 / (5 + 1e-6) and -4 / (5 + 1e-6)
    clip_norm(&mut gradient, 1.0);
    assert_eq!(gradient, [0.599_999_9, -0.799_999_83, 0.0]);
    clip_norm(&mut gradient, 1e-30);
    assert!(gradient[0] > 0.0 && gradient[0] < 1e-30);
}

#[test]
fn what_is_not_finite_does_not_become_finite() {
    for bad in [f32::NAN, f32::INFINITY] {
        let mut gradient = [1.0, bad];
        clip_norm(&mut gradient, 1.0);
        assert!(!gradient[1].is_finite());
    }
}

#[test]
fn the_learning_rate_falls_in_a_straight_line_and_stays() {
    let schedule = Some(LearningRateSchedule { final_learning_rate: 0.25, steps: 4 });
    let mut config = LearningRate { learning_rate: 0.75, schedule };
    let rates = |config: &LearningRate| [0, 1, 3, 4, 99].map(|step| config.after(step));
    assert_eq!(rates(&config), [0.75, 0.625, 0.375, 0.25, 0.25]);
    config.schedule = None;
    assert_eq!(rates(&config), [0.75; 5]);
}
