//! Tables of others: what turns a top-level table that the runtime does not know into tasks.

use crate::{
    diagnostic::{Findings, Place},
    node::Node,
};

/// Makes tasks out of a top-level table of its own, for example the vision tasks out of the list
/// of services in `[vss]`.
pub trait Expander {
    /// Checks the table and returns its tasks; whatever is wrong goes to `findings`.
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask>;

    /// Tables that the table stands for, chassis and tasks for example. They are read and checked as if a file had
    /// them, and what the app itself says lies over them.
    fn tables(&self, _table: &Node, _findings: &mut Findings) -> Node {
        Node::table()
    }
}

/// A task made by an [`Expander`].
#[derive(Debug, Clone, PartialEq)]
pub struct GeneratedTask {
    /// Its symbolic name.
    pub name: String,
    /// The handler's registered name.
    pub handler: String,
    /// `CHASSIS` or `CHASSIS/PROCESSOR`.
    pub on: String,
    /// What the handler gets as its arguments.
    pub args: Node,
    /// The part of the file that it was made from; findings about the task point there.
    pub place: Place,
}
