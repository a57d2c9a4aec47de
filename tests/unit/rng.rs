use super::*;

// numpy 2.4.6: default_rng(SeedSequence(seed, spawn_key=key)).bit_generator.random_raw(2)
const NUMPY: [(u64, &[u32], [u64; 2]); 8] = [
    (0, &[], [11749869230777074271, 4976686463289251617]),
    (0, &[0], [17394127715520444142, 5835390491061343638]),
    (0, &[3], [6722610277276733253, 9432498999466319913]),
    ((1 << 32) - 1, &[], [4647538520743280031, 4041050679407036418]),
    (1 << 32, &[], [16412783775159424549, 10277383025879800780]),
    (1 << 32, &[3], [18191313451190898968, 5108984316022369131]),
    (u64::MAX, &[], [12544278110101001871, 15593249672699323225]),
    (u64::MAX, &[3], [1552385388703065254, 10059405471324675964]),
];

#[test]
fn draws_what_numpy_draws() {
    for (seed, key, expected) in NUMPY {
        let mut rng = Rng::from_seed_sequence(seed, key);
        assert_eq!([rng.next_u64(), rng.next_u64()], expected, "seed {seed}, spawn key {key:?}");
    }
}

#[test]
fn below_stays_below_and_reaches_everything() {
    let mut rng = Rng::from_seed(1);
    let mut counts = [0; 5];
    for _ in 0..5_000 {
        counts[rng.below(5) as usize] += 1;
    }
    assert!(counts.iter().all(|&count| (850..1150).contains(&count)), "{counts:?}");
}
