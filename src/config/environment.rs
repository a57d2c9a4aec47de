//! The environment of a config: a name, or a program. No file starts a program, only [`EnvironmentConfig::allow`] does.

use std::fmt;
use std::sync::Arc;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value, json};

use super::ConfigError;
use super::keys::{ENVIRONMENT as KEY, object};
use super::layer::{Layer, members_of, misplaced};
use crate::env::catalogue::EnvironmentId;
use crate::env::{EnvironmentError, Make, Spec};
use crate::text::{excerpt, shell_line};

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub(crate) enum EnvironmentConfig {
    /// An environment of this crate.
    Named(EnvironmentId),
    Program(Box<ProgramConfig>),
}

impl<'de> Deserialize<'de> for EnvironmentConfig {
    /// By hand, because an untagged enum would not say what is wrong with a program.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let config = match Value::deserialize(deserializer)? {
            name @ Value::String(_) => EnvironmentId::deserialize(name).map(Self::Named),
            program => ProgramConfig::deserialize(program).map(|program| Self::Program(Box::new(program))),
        };
        config.map_err(D::Error::custom)
    }
}

/// A program that is an environment, see `docs/environments.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ProgramConfig {
    pub(crate) command: Vec<String>,
    /// In how many processes at the same time evaluations are played.
    pub(crate) processes: u32,
    /// Seconds within which the program must answer.
    pub(crate) timeout_seconds: u32,
    /// What the program has said of its task. A run records it, so that a report starts no program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<Spec>,
    #[serde(skip)]
    permission: Permission,
}

/// What starts the program; none as long as nobody has allowed that.
#[derive(Clone, Default)]
struct Permission(Option<Arc<Make>>);

impl PartialEq for Permission {
    /// A permission is no part of a config.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl fmt::Debug for Permission {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Permission")
    }
}

impl EnvironmentConfig {
    pub fn spec(&self) -> Result<Spec, EnvironmentError> {
        match self {
            Self::Named(id) => Ok(id.spec()),
            Self::Program(program) => program.task.clone().ok_or_else(|| {
                EnvironmentError::new(&program.name(), "its task is not known, because it was never started")
            }),
        }
    }

    pub fn make(&self) -> Arc<Make> {
        match self.clone() {
            Self::Named(id) => Arc::new(move |max_steps| id.make(max_steps)),
            Self::Program(program) => match program.permission() {
                Ok(make) => Arc::clone(make),
                Err(refusal) => Arc::new(move |_| Err(refusal.clone())),
            },
        }
    }

    /// The whole command of a program, as it can be typed into a shell; none of an environment of this crate.
    pub(crate) fn command(&self) -> Option<String> {
        match self {
            Self::Named(_) => None,
            Self::Program(program) => Some(shell_line(&program.command)),
        }
    }

    /// Allows the program to be started. `show` takes its command and each line of its standard error.
    #[cfg(feature = "program")]
    pub(crate) fn allow(&mut self, show: crate::env::program::ShowLine) {
        if let Self::Program(program) = self {
            let programs = Arc::new(crate::env::program::Programs::new(
                program.command.clone(),
                program.processes as usize,
                std::time::Duration::from_secs(program.timeout_seconds.into()),
                program.task.clone(),
                show,
            ));
            program.permission = Permission(Some(Arc::new(move |max_steps| {
                Ok(Box::new(crate::env::TimeLimit::new(programs.make()?, max_steps)))
            })));
        }
    }

    /// Starts a program that is allowed to, and asks it for its task.
    pub(super) fn ask(&mut self) -> Result<(), EnvironmentError> {
        if let Self::Program(program) = self {
            let environment = program.permission()?(1)?;
            program.task = Some(environment.spec().clone());
        }
        Ok(())
    }
}

impl ProgramConfig {
    /// The beginning of the command, for messages.
    fn name(&self) -> String {
        excerpt(&shell_line(&self.command), 200)
    }

    fn permission(&self) -> Result<&Arc<Make>, EnvironmentError> {
        let refusal = || EnvironmentError::new(&self.name(), "nobody has allowed its program to be started");
        self.permission.0.as_ref().ok_or_else(refusal)
    }
}

/// The members of a program that have defaults.
pub(super) fn program_defaults() -> Map<String, Value> {
    object(json!({"processes": 1, "timeout_seconds": 60}))
}

/// Merges the environment. A name or a command begins afresh; the other keys of a program change that of a lower layer.
pub(super) fn merged(default: &EnvironmentConfig, layers: &[Layer]) -> Result<Value, ConfigError> {
    let mut value = json!(default);
    for Layer { origin, values } in layers {
        let own = members_of(KEY, values);
        if let Some(name) = values.get(KEY) {
            value = name.clone();
        }
        if own.contains_key("command") && !values.contains_key(KEY) {
            value = program_defaults().into();
        }
        match &mut value {
            Value::Object(members) => members.extend(own),
            name => {
                if let Some(key) = own.keys().next() {
                    let hint =
                        format!("`{KEY}` is {name} here, and only a program, with `command`, has such keys");
                    return Err(misplaced(origin, &format!("{KEY}.{key}"), hint));
                }
            }
        }
    }
    Ok(value)
}
