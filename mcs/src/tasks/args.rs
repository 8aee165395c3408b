//! Arguments of the MCS tasks that belong to a servo, as they stand in the configuration.

use serde::Deserialize;

/// Arguments of `mcs.state` and `mcs.planner`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartArgs {
    /// Name of the servo task, on the same chassis.
    pub servo: String,
}

/// Arguments of `mcs.client`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClientArgs {
    /// Name of the servo task.
    pub servo: String,
    /// Name of the state manager's task.
    pub state: String,
    /// Name of the planner's task.
    pub planner: String,
}
