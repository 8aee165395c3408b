//! Why there is no answer, or no exact one.

use thiserror::Error;

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PerfError {
    /// Nothing takes any time.
    #[error(
        "nothing in the net takes time: give transitions a line such as `time exponential 2 s`"
    )]
    NothingTimed,
    /// Transitions fire for ever without any time between them.
    #[error("transitions fire in a circle that takes no time, from {marking}")]
    Timeless {
        /// A marking of the circle, in words.
        marking: String,
    },
    /// Nothing can fire any more, so that there is no steady state but that.
    #[error("the net stops: nothing can fire at {marking}, so it has no steady state to speak of")]
    Stops {
        /// The marking, in words.
        marking: String,
    },
    /// A place got more tokens than can be counted.
    #[error("a place overflows: {0}")]
    Overflow(String),
    /// An option makes no sense.
    #[error("{0}")]
    Option(String),
    /// A net has what the model cannot say.
    #[error(
        "transition `{transition}` empties the place `{place}`, in which actions are kept room: that can be analysed for places of small capacity, when the transition takes no time, or an exponential one with one server"
    )]
    ResetOfPromised {
        /// The transition with the reset arc.
        transition: String,
        /// The place.
        place: String,
    },
}

/// Why there is no exact solution, while simulation may give an answer.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NotExact {
    /// A time is not exponential.
    #[error("the time of transition `{0}` is not exponential")]
    NotExponential(String),
    /// There are too many markings, perhaps without end.
    #[error("there are more than {0} markings")]
    TooMany(usize),
    /// What the net does in the long run depends on chance early on.
    #[error(
        "the net ends in one of {classes} separate sets of markings, such as {first} and {second}"
    )]
    Parts {
        /// How many sets.
        classes: usize,
        /// A marking of the first.
        first: String,
        /// A marking of the second.
        second: String,
    },
    /// The iteration did not come to an end.
    #[error("the solution did not converge in {sweeps} sweeps (change {change:e})")]
    NoConvergence {
        /// Sweeps done.
        sweeps: usize,
        /// Relative change of the last one.
        change: f64,
    },
    /// It cannot be answered at all.
    #[error(transparent)]
    Never(#[from] PerfError),
}
