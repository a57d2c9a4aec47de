use super::*;

#[test]
fn linear_falls_in_a_straight_line_and_stays() {
    let schedule = Exploration::Linear { initial: 1.0, final_: 0.2, steps: 4, repeat: 1 };
    let epsilons: Vec<f64> = (0..7).map(|step| schedule.after_step(f64::NAN, step)).collect();
    assert_eq!(epsilons, [1.0, 0.8, 0.6, 0.3999999999999999, 0.2, 0.2, 0.2]);
    assert_eq!(schedule.after_episode(0.6), 0.6);
}

#[test]
fn per_episode_decays_until_it_is_at_or_below_the_final_value() {
    let schedule = Exploration::PerEpisode { initial: 1.0, final_: 0.3, decay: 0.5, repeat: 1 };
    let mut epsilon = EpsilonGreedy::new(schedule, Rng::from_seed(0)).epsilon;
    let epsilons: Vec<f64> = std::iter::repeat_with(|| {
        epsilon = schedule.after_episode(schedule.after_step(epsilon, 7));
        epsilon
    })
    .take(4)
    .collect();
    assert_eq!(epsilons, [0.5, 0.25, 0.25, 0.25]);
}

#[test]
fn a_duration_of_n_steps_has_a_probability_proportional_to_one_over_n_squared() {
    let mut rng = Rng::from_seed(0);
    let mut counts = [0; 5];
    for _ in 0..100_000 {
        counts[zeta(&mut rng, 4) as usize] += 1;
    }
    // 6/π² = 0.6079; a quarter and a ninth of it; the rest is 0.1724.
    let expected = [0, 60_793, 15_198, 6_755, 17_254];
    for (count, expected) in counts.iter().zip(expected) {
        assert!(i32::abs(count - expected) < 600, "{counts:?}");
    }
}

#[test]
fn a_random_action_is_taken_again_until_its_time_or_the_episode_is_over() {
    let schedule = Exploration::PerEpisode { initial: 1.0, final_: 0.0, decay: 1.0, repeat: 50 };
    let mut exploration = EpsilonGreedy::new(schedule, Rng::from_seed(3));
    while exploration.held.1 < 2 {
        exploration.explore(4);
    }
    let (action, left) = exploration.held;
    exploration.epsilon = 0.0;
    for _ in 0..left {
        assert_eq!(exploration.explore(4), Some(action));
    }
    assert_eq!(exploration.explore(4), None);
    exploration.held = (action, 7);
    exploration.after_episode();
    assert_eq!(exploration.explore(4), None);
}
