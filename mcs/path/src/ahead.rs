//! Looking ahead along motions that would be made one after another. All that the collision guard watches has to keep its distances
//! from the beginning of the first to the end of the last.

use mcs::Joints;
use mcs::client::Plan;
use mcs::trajectory::Planner;
use serde::{Deserialize, Serialize};

use crate::space::{Space, Touch};

/// A motion is cut into so many pieces of the same time. Each is taken as straight in the joints, which it is but for a millimetre.
const PIECES: u32 = 64;

/// No more motions are looked at in one request: nothing else has its turn meanwhile.
const MOST: usize = 64;

/// Why motions may not be made. They are counted from 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum Refused {
    /// The arm cannot make one of them.
    #[error("motion {motion}: {reason}")]
    Unplanned {
        /// Which.
        motion: usize,
        /// In words.
        reason: String,
    },
    /// On one of them two solids come too near to one another.
    #[error("motion {motion}: {touch}")]
    Touches {
        /// Which.
        motion: usize,
        /// The solids.
        touch: Touch,
    },
}

/// Where the joints are after these motions, rad or m, on which all distances of the space are kept. Solids that are nearer than that
/// where the first motion begins come no nearer in it.
///
/// # Errors
/// What is in the way of the first motion that cannot be made.
pub fn look(
    planner: &mut Planner,
    space: &mut Space,
    from: &Joints,
    motions: &[Plan],
) -> Result<Joints, Refused> {
    if motions.len() > MOST {
        let reason = format!("no more than {MOST} motions are looked at at once");
        let motion = MOST + 1;
        return Err(Refused::Unplanned { motion, reason });
    }
    let mut here = *from;
    for (motion, plan) in (1..).zip(motions) {
        let before = (motion == 1).then(|| {
            let relaxed = space.relaxed_at(from, f64::NEG_INFINITY);
            space.keep(relaxed)
        });
        let goes = along(planner, space, (&here, plan));
        if let Some(before) = before {
            space.keep(before);
        }
        here = goes.map_err(|wrong| match wrong {
            Wrong::Unplanned(reason) => Refused::Unplanned { motion, reason },
            Wrong::Touches(touch) => Refused::Touches { motion, touch },
        })?;
    }
    Ok(here)
}

/// What is wrong with a motion.
enum Wrong {
    Unplanned(String),
    Touches(Touch),
}

/// Where one motion ends.
fn along(
    planner: &mut Planner,
    space: &mut Space,
    (from, plan): (&Joints, &Plan),
) -> Result<Joints, Wrong> {
    let unplanned = |error: &dyn ToString| Wrong::Unplanned(error.to_string());
    let route = plan.route().map_err(|error| unplanned(&error))?;
    let planned = planner.segment(from, &route);
    let (segment, end) = planned.map_err(|error| unplanned(&error))?;
    let (mut solver, mut here) = (planner.solver().clone(), *from);
    for piece in 1..=PIECES {
        let time = segment.duration() * f64::from(piece) / f64::from(PIECES);
        let next = segment.at(&mut solver, time, &here);
        let next = next.map_err(|error| unplanned(&error))?.position;
        space.goes_free(&here, &next).map_err(Wrong::Touches)?;
        here = next;
    }
    Ok(end)
}
