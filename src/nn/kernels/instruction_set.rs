//! Which instruction sets this CPU has, and which of them the kernels run on.

use std::sync::OnceLock;

use super::vector::Vector;

/// Every instruction set, the slowest first: a name for [`InstructionSetKind`], the vector that computes with it, the targets that can have
/// it, and what the compiler may use in its kernels. A new one is a file with its vector, a `mod` of that file, and a line here.
macro_rules! instruction_sets {
    ($then:ident! $($arguments:tt)*) => {
        $then! {
            [
                { Scalar = super::scalar::Scalar, all() }
                { Avx2 = super::avx2::Avx2, target_arch = "x86_64", "avx2,fma" }
                { Avx512 = super::avx512::Avx512, target_arch = "x86_64", "avx512f,avx2,fma" }
                { Neon = super::neon::Neon, target_arch = "aarch64" }
                { Wasm = super::wasm::Wasm, all(target_arch = "wasm32", target_feature = "simd128") }
            ]
            $($arguments)*
        }
    };
}

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
pub struct InstructionSet(pub(super) InstructionSetKind);

/// `CARTPOLE_DQN_SIMD` names an instruction set that this CPU does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} is {asked:?}; this CPU can run {}", InstructionSet::VARIABLE, names(&InstructionSet::available()))]
pub(crate) struct UnknownInstructionSet {
    asked: String,
}

fn names(instruction_sets: &[InstructionSet]) -> String {
    instruction_sets.iter().map(|set| set.name()).collect::<Vec<_>>().join(", ")
}

impl InstructionSet {
    pub const SCALAR: Self = Self(InstructionSetKind::Scalar);

    /// The environment variable that names the instruction set to run on, for tests and comparisons.
    pub const VARIABLE: &str = "CARTPOLE_DQN_SIMD";

    /// The instruction set that networks compute with, decided once for the process: what [`Self::from_environment`] gives,
    /// or the fastest if [`Self::VARIABLE`] names none that this CPU has.
    pub fn current() -> Self {
        static CURRENT: OnceLock<InstructionSet> = OnceLock::new();
        *CURRENT.get_or_init(|| Self::from_environment().unwrap_or(Self::available()[0]))
    }

    /// The instruction set that [`Self::VARIABLE`] names (`scalar`, `avx2`, `avx512` or `neon`), or the fastest if the variable
    /// is not set.
    pub(crate) fn from_environment() -> Result<Self, UnknownInstructionSet> {
        let available = Self::available();
        let Some(asked) = std::env::var_os(Self::VARIABLE) else { return Ok(available[0]) };
        let asked = asked.to_string_lossy().into_owned();
        available.into_iter().find(|set| set.name() == asked).ok_or(UnknownInstructionSet { asked })
    }
}

macro_rules! declare {
    ([$({ $kind:ident = $vector:ty, $cfg:meta $(, $features:tt)? })*]) => {
        /// What an [`InstructionSet`] is.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum InstructionSetKind {
            $(#[cfg($cfg)] $kind,)*
        }

        impl InstructionSet {
            /// All instruction sets that this CPU has, the fastest first.
            pub fn available() -> Vec<Self> {
                let mut available = Vec::new();
                $(
                    #[cfg($cfg)]
                    if <$vector as Vector>::is_available() {
                        available.push(Self(InstructionSetKind::$kind));
                    }
                )*
                available.reverse();
                available
            }

            /// Its name in [`Self::VARIABLE`].
            pub fn name(self) -> &'static str {
                match self.0 {
                    $(#[cfg($cfg)] InstructionSetKind::$kind => <$vector as Vector>::NAME,)*
                }
            }
        }
    };
}
instruction_sets! { declare! }
