use super::*;
use crate::agent::NotFinite;
use crate::env::EnvironmentError;

#[test]
fn only_divergence_is_an_error_that_is_a_result() {
    let diverged = TrainError::Diverged { env_steps: 7, what: NotFinite::Loss };
    let environment = TrainError::from(EnvironmentError::new("./dock", "it ended"));
    for (error, is_circumstance) in [(diverged, false), (environment, true)] {
        let trial = Trial::<Value> {
            config: "a".into(),
            seed: 0,
            error: Some(error.to_string()),
            summary: None,
            best: None,
            final_: None,
            evaluations: Vec::new(),
        };
        assert_eq!(trial.is_circumstance(), is_circumstance, "{error}");
    }
}
