//! One seed, one named stream of random numbers per consumer.
//!
//! The generator is PCG64 (O'Neill 2014, XSL-RR 128/64) seeded through NumPy's `SeedSequence`, so that
//! [`Rng::from_seed`] draws what `numpy.random.default_rng(seed)` draws; that gives Gymnasium's episodes.
//! Integers and floats are drawn by the few lines here and not by a crate's distributions, which may change.

/// Who draws from a stream. A run spawns one stream for each from its seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    Init = 0,
    /// Start states of the training episodes.
    Environment = 1,
    /// Exploration: whether to explore, and which action.
    Explore = 2,
    /// Minibatches.
    Replay = 3,
}

/// The multiplier of PCG's 128-bit generators.
const MULTIPLIER: u128 = 0x2360_ed05_1fc6_5da4_4385_df64_9fcc_f645;

/// A stream of random numbers: PCG64, a linear congruential generator whose state is mixed into 64 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rng {
    state: u128,
    /// Odd: which of the generator's sequences this is.
    increment: u128,
}

impl Rng {
    /// Where the stream is, for a checkpoint: state and increment of PCG64, the low half of each first.
    pub(crate) fn to_words(&self) -> [u64; 4] {
        let Self { state, increment } = *self;
        [state as u64, (state >> 64) as u64, increment as u64, (increment >> 64) as u64]
    }

    /// The inverse of [`Self::to_words`]. None for an even increment: with a short period a repeated draw could hang.
    pub(crate) fn from_words(words: [u64; 4]) -> Option<Self> {
        let [state_low, state_high, increment_low, increment_high] = words;
        let (state, increment) = (join(state_high, state_low), join(increment_high, increment_low));
        (!increment.is_multiple_of(2)).then_some(Self { state, increment })
    }

    /// The stream of `numpy.random.default_rng(seed)`.
    pub fn from_seed(seed: u64) -> Self {
        Self::from_seed_sequence(seed, &[])
    }

    /// The stream of `numpy.random.default_rng(numpy.random.SeedSequence(seed, spawn_key=(stream,)))`.
    pub fn spawn(seed: u64, stream: Stream) -> Self {
        Self::from_seed_sequence(seed, &[stream as u32])
    }

    fn from_seed_sequence(seed: u64, spawn_key: &[u32]) -> Self {
        let [state_high, state_low, stream_high, stream_low] = seed_sequence(seed, spawn_key);
        let increment = (join(stream_high, stream_low) << 1) | 1;
        let mut rng = Self { state: join(state_high, state_low).wrapping_add(increment), increment };
        rng.step();
        rng
    }

    fn step(&mut self) {
        self.state = self.state.wrapping_mul(MULTIPLIER).wrapping_add(self.increment);
    }

    /// 64 random bits: both halves of the next state, mixed and rotated by its highest six bits.
    pub(crate) fn next_u64(&mut self) -> u64 {
        self.step();
        let mixed = (self.state >> 64) as u64 ^ self.state as u64;
        mixed.rotate_right((self.state >> 122) as u32)
    }

    /// A uniform number in [0, 1) with 53 random bits, as NumPy draws it.
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// A uniform number in [`low`, `high`), as NumPy's `Generator.uniform` draws it.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A uniform integer in `0..bound`, not 0, without bias (Lemire 2019, "Fast random integer generation in an interval").
    pub fn below(&mut self, bound: u64) -> u64 {
        debug_assert!(bound > 0);
        let mut product = u128::from(self.next_u64()) * u128::from(bound);
        if (product as u64) < bound {
            let threshold = bound.wrapping_neg() % bound;
            while (product as u64) < threshold {
                product = u128::from(self.next_u64()) * u128::from(bound);
            }
        }
        (product >> 64) as u64
    }
}

fn join(high: u64, low: u64) -> u128 {
    (u128::from(high) << 64) | u128::from(low)
}

/// NumPy's `SeedSequence(seed, spawn_key=spawn_key).generate_state(4, numpy.uint64)`.
///
/// Hashes seed and key into a pool of four 32-bit words and draws eight words from it (after O'Neill's
/// `seed_seq_fe`, 2015); the constants are NumPy's.
fn seed_sequence(seed: u64, spawn_key: &[u32]) -> [u64; 4] {
    const POOL_SIZE: usize = 4;
    const INIT_A: u32 = 0x43b0_d7e5;
    const MULT_A: u32 = 0x931e_8875;
    const INIT_B: u32 = 0x8b51_f9dd;
    const MULT_B: u32 = 0x58f3_8ded;
    const MIX_MULT_L: u32 = 0xca01_f9dd;
    const MIX_MULT_R: u32 = 0x4973_f715;

    /// One step of the hash: `constant` moves on, `value` is folded into it.
    fn hash(value: u32, constant: &mut u32, multiplier: u32) -> u32 {
        let value = value ^ *constant;
        *constant = constant.wrapping_mul(multiplier);
        let value = value.wrapping_mul(*constant);
        value ^ (value >> 16)
    }
    fn mix(x: u32, y: u32) -> u32 {
        let mixed = x.wrapping_mul(MIX_MULT_L).wrapping_sub(y.wrapping_mul(MIX_MULT_R));
        mixed ^ (mixed >> 16)
    }

    // A seed is at most two words, so it never outgrows the pool; missing words hash as 0.
    let mut constant = INIT_A;
    let words = [seed as u32, (seed >> 32) as u32, 0, 0];
    let mut pool: [u32; POOL_SIZE] = words.map(|word| hash(word, &mut constant, MULT_A));
    for source in 0..POOL_SIZE {
        for destination in (0..POOL_SIZE).filter(|&destination| destination != source) {
            pool[destination] = mix(pool[destination], hash(pool[source], &mut constant, MULT_A));
        }
    }
    for &word in spawn_key {
        for destination in &mut pool {
            *destination = mix(*destination, hash(word, &mut constant, MULT_A));
        }
    }

    let mut constant = INIT_B;
    let words: [u32; 8] = std::array::from_fn(|i| hash(pool[i % POOL_SIZE], &mut constant, MULT_B));
    std::array::from_fn(|i| u64::from(words[2 * i]) | (u64::from(words[2 * i + 1]) << 32))
}

#[cfg(test)]
#[path = "../tests/unit/rng.rs"]
mod tests;
