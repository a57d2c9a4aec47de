//! Which instruction sets this CPU has, and which of them the kernels run on.

use std::sync::OnceLock;

/// An instruction set that this CPU has. All instruction sets give the same bits.
///
/// Only this type's functions make one, after they have looked whether the CPU has it. So a safe kernel that takes an
/// `InstructionSet` never runs instructions that the CPU lacks:
///
/// ```
/// use cartpole_dqn::nn::kernels::InstructionSet;
/// let instruction_set: InstructionSet = InstructionSet::SCALAR;
/// assert!(InstructionSet::available().contains(&instruction_set));
/// ```
///
/// ```compile_fail,E0423
/// use cartpole_dqn::nn::kernels::InstructionSet;
/// let instruction_set: InstructionSet = InstructionSet(todo!());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstructionSet(Kind);

/// What an [`InstructionSet`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Any CPU.
    Scalar,
    /// x86-64 with AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// x86-64 with AVX-512F, AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// WebAssembly with 128-bit vectors.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128", not(target_feature = "relaxed-simd")))]
    Simd128,
    /// WebAssembly with relaxed vectors, whose multiply-add fuses here.
    #[cfg(all(target_arch = "wasm32", target_feature = "relaxed-simd"))]
    RelaxedSimd,
}

/// `CARTPOLE_DQN_SIMD` names an instruction set that this CPU does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} is {asked:?}; this CPU can run {}", InstructionSet::VARIABLE, names(&InstructionSet::available()))]
pub struct UnknownInstructionSet {
    asked: String,
}

fn names(instruction_sets: &[InstructionSet]) -> String {
    instruction_sets.iter().map(|set| set.name()).collect::<Vec<_>>().join(", ")
}

impl InstructionSet {
    /// What every CPU can run.
    pub const SCALAR: Self = Self(Kind::Scalar);

    /// The environment variable that names the instruction set to run on, for tests and comparisons.
    pub const VARIABLE: &str = "CARTPOLE_DQN_SIMD";

    /// The instruction set that networks compute with: what [`Self::from_environment`] gives, or the fastest
    /// instruction set if [`Self::VARIABLE`] names none that this CPU has. The first call decides for the whole
    /// process.
    pub fn current() -> Self {
        static CURRENT: OnceLock<InstructionSet> = OnceLock::new();
        *CURRENT.get_or_init(|| Self::from_environment().unwrap_or(Self::available()[0]))
    }

    /// The instruction set that [`Self::VARIABLE`] names (`scalar`, `avx2` or `avx512`), or the fastest if the variable
    /// is not set.
    ///
    /// # Errors
    /// When the variable names no instruction set that this CPU has.
    pub fn from_environment() -> Result<Self, UnknownInstructionSet> {
        let available = Self::available();
        let Some(asked) = std::env::var_os(Self::VARIABLE) else { return Ok(available[0]) };
        let asked = asked.to_string_lossy().into_owned();
        available.into_iter().find(|set| set.name() == asked).ok_or(UnknownInstructionSet { asked })
    }

    /// All instruction sets that this CPU has, the fastest first.
    pub fn available() -> Vec<Self> {
        let mut available = vec![Self::SCALAR];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            available.push(Self(Kind::Avx2));
            if is_x86_feature_detected!("avx512f") {
                available.push(Self(Kind::Avx512));
            }
        }
        #[cfg(all(
            target_arch = "wasm32",
            target_feature = "simd128",
            not(target_feature = "relaxed-simd")
        ))]
        available.push(Self(Kind::Simd128));
        #[cfg(all(target_arch = "wasm32", target_feature = "relaxed-simd"))]
        if super::wasm::RelaxedSimd::is_fused() {
            available.push(Self(Kind::RelaxedSimd));
        }
        available.reverse();
        available
    }

    /// Its name in [`Self::VARIABLE`].
    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
            #[cfg(all(
                target_arch = "wasm32",
                target_feature = "simd128",
                not(target_feature = "relaxed-simd")
            ))]
            Kind::Simd128 => "simd128",
            #[cfg(all(target_arch = "wasm32", target_feature = "relaxed-simd"))]
            Kind::RelaxedSimd => "relaxed-simd",
        }
    }

    pub(super) fn kind(self) -> Kind {
        self.0
    }
}
