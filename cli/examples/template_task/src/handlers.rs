//! The functions that the net `pick` names. Each is a request to a service object of the app, as a person types it in
//! `scott`.

use std::{f64::consts::PI, time::Duration};

use ctos::{registry::Registry, task::HandlerError};
use pnt::library::{Acted, Action, Library};
use serde::Deserialize;
use sorma::{Dictionary, Request, Sorm, daemon::Tasks};

/// The longest that one motion may take.
const LONGEST: Duration = Duration::from_secs(60);

/// What stands in `[task.pick.args]` besides the net.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PickArgs {
    object: Object,
}

/// What is picked up: `object.toml`.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Object {
    from_m: [f64; 3],
    to_m: [f64; 3],
    turn_rad: f64,
    open_m: f64,
    force_n: f64,
    above_m: f64,
    speed: f64,
}

impl Object {
    /// A pose of the gripper, pointing down `above` over a place, as `mvpos EXEC place` takes it: x, y, z, roll, pitch, yaw.
    fn pose(&self, [x, y, z]: [f64; 3], above: f64) -> String {
        format!("FMSG 6 {x} {y} {} {PI} 0 {}", z + above, self.turn_rad)
    }
}

/// What the functions share.
struct Pick {
    object: Object,
    sorm: Sorm,
}

/// A function that makes these requests of the daemon `objects`, one after the other, up to the first that fails. Why it
/// failed stands below the net's answer.
async fn ask(action: Action<Pick>, requests: impl FnOnce(&Object) -> Vec<String>) -> Acted {
    let (requests, sorm) = action.with_state(|pick| (requests(&pick.object), pick.sorm.clone()));
    let objects = Tasks::of(action.cx()).deadline(LONGEST);
    for line in requests {
        let request: Request = line.parse()?;
        let answer = sorm.ask(&objects, request).await;
        if !answer.body.is_ok() {
            let why = answer.body.said();
            action.note(format!("{}: {why}", action.transition()));
            return Err(HandlerError::new(why));
        }
    }
    Ok(())
}

async fn reserve(action: Action<Pick>) -> Acted {
    let speed = |object: &Object| {
        let keep = format!("mvpos@objects CTRL -keep on -speed {}", object.speed);
        vec![keep]
    };
    ask(action, speed).await
}

async fn give_back(action: Action<Pick>) -> Acted {
    ask(action, |_| vec!["mvpos@objects EXEC release".to_owned()]).await
}

async fn open(action: Action<Pick>) -> Acted {
    let width = |object: &Object| {
        vec![format!(
            "gripper@objects EXEC open FMSG 1 {}",
            object.open_m
        )]
    };
    ask(action, width).await
}

async fn go_above(action: Action<Pick>) -> Acted {
    let place = |object: &Object| along("joint", &object.pose(object.from_m, object.above_m));
    ask(action, place).await
}

async fn lower(action: Action<Pick>) -> Acted {
    ask(action, |object| {
        along("line", &object.pose(object.from_m, 0.0))
    })
    .await
}

async fn grasp(action: Action<Pick>) -> Acted {
    let force = |object: &Object| {
        let close = format!("gripper@objects EXEC grasp FMSG 1 {}", object.force_n);
        vec![close, HOLDS.to_owned()]
    };
    ask(action, force).await
}

async fn lift(action: Action<Pick>) -> Acted {
    let up = |object: &Object| {
        let shift = format!(
            "mvpos@objects EXEC shift FMSG 6 0 0 {} 0 0 0",
            object.above_m
        );
        vec![shift]
    };
    ask(action, up).await
}

async fn holds(action: Action<Pick>) -> Acted {
    ask(action, |_| vec![HOLDS.to_owned()]).await
}

async fn go_over(action: Action<Pick>) -> Acted {
    let place = |object: &Object| along("line", &object.pose(object.to_m, object.above_m));
    ask(action, place).await
}

async fn put_down(action: Action<Pick>) -> Acted {
    let down = |object: &Object| {
        let mut requests = vec![HOLDS.to_owned()];
        requests.extend(along("line", &object.pose(object.to_m, 0.0)));
        requests
    };
    ask(action, down).await
}

/// Ends with an error when nothing is held.
const HOLDS: &str = "gripper@objects EXEC holds";

/// A motion to a pose, in joint space or on a straight line.
fn along(path: &str, pose: &str) -> Vec<String> {
    vec![
        format!("mvpos@objects CTRL -path {path}"),
        format!("mvpos@objects EXEC place {pose}"),
    ]
}

fn library(args: PickArgs) -> Library<Pick> {
    let pick = Pick {
        object: args.object,
        sorm: Sorm::new(Dictionary::new()),
    };
    Library::new(pick)
        .action("reserve", reserve)
        .action("give_back", give_back)
        .action("open", open)
        .action("go_above", go_above)
        .action("lower", lower)
        .action("grasp", grasp)
        .action("lift", lift)
        .action("holds", holds)
        .action("go_over", go_over)
        .action("put_down", put_down)
}

/// Every event handler that `app.toml` can name: those of CTOS, and the one that runs the net.
pub fn registry() -> Registry {
    let mut registry = cli::program::registry();
    pnt::task::register_with(&mut registry, "my_app.net", library);
    registry
}
