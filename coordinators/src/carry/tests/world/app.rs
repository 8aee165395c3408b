//! The app around the stand-ins, and how it is run.

use mcs::client::Move;

use ctos::message::Command as _;

use super::{BLINKS, World};
use crate::bench::{self, configs};

/// The tasks of the nets.
pub(crate) fn tasks(believes: &str) -> String {
    let configs = configs();
    format!(
        r#"
[task.dispatcher]
handler = "coordinators.carry"
on = "ws1"
[task.dispatcher.args]
net = "{configs}/nets/carry/dispatcher.net"
thing = "{configs}/carry/disc.toml"
show = true
board = {{ at = [0.5, 0.0, 0.42], yaw_deg = 20.0, field_m = 0.06, dot = [-0.255, -0.21] }}
[task.robot]
handler = "coordinators.carry_robot"
on = "ws1"
[task.robot.args]
net = "{configs}/nets/carry/robot.net"
touch = ["touch"]
park_deg = [0, 75, -180, 0, -75, 0]
service_within_s = 2.0
[task.hand]
handler = "coordinators.carry_hand"
on = "ws1"
[task.hand.args]
net = "{configs}/nets/carry/hand.net"
service_within_s = 2.0
[task.laser]
handler = "coordinators.carry_laser"
on = "ws1"
[task.laser.args]
net = "{configs}/nets/carry/laser.net"
light = [0.05, 0.0, -0.065]
blinks = {BLINKS}
park_deg = [0, 75, -180, 0, -75, 0]
service_within_s = 2.0
[task.people]
handler = "coordinators.carry_people"
on = "ws1"
args.net = "{configs}/nets/carry/people.net"
[task.pusher]
handler = "coordinators.push_arm"
on = "ws1"
[task.pusher.args]
net = "{configs}/nets/push/pusher.net"
height_m = 0.437
light = true
park_deg = [0, 75, -180, 0, -75, 0]
service_within_s = 2.0
[task.vision]
handler = "coordinators.carry_vision"
on = "ws1"
[task.vision.args]
net = "{configs}/nets/carry/vision.net"
board = "{believes}"
service_within_s = 2.0
"#,
        configs = configs.display()
    )
}

/// The stand-ins by the names of their tasks.
pub(crate) const STAND_INS: [&str; 6] = ["mcs", "gripper", "eyes", "paths", "vsm", "toolSnap"];

/// Things that are stuck to the one to be carried are pushed aside.
pub(crate) const PUSHES: &str = "task.dispatcher.args.pushes=3";

/// The camera on the hand looks from two poses.
pub(crate) const POSES: &str = "task.vision.args.another={ park_deg = [0, 75, -180, 0, -75, 0], \
    poses = [{ at_deg = [[10, 0, 0, 0, 0, 0], [11, 0, 0, 0, 0, 0]] }, \
    { at_deg = [[20, 0, 0, 0, 0, 0], [21, 0, 0, 0, 0, 0]], cost_s = 12.0 }] }";

pub(crate) fn run(world: World, commands: &[&str]) -> World {
    run_seeded(world, commands, 1)
}

/// One command, with settings as `--set` takes them.
pub(crate) fn run_with(world: World, sets: &[&str]) -> World {
    run_all_with(world, &[CARRY], sets)
}

/// The same with other commands.
pub(crate) fn run_all_with(world: World, commands: &[&str], sets: &[&str]) -> World {
    let app = bench::app(&tasks(world.believes), &STAND_INS);
    let sets: Vec<String> = sets.iter().map(ToString::to_string).collect();
    bench::run_with(world, (&app, &sets), commands, &[])
}

pub(crate) fn run_seeded(world: World, commands: &[&str], seed: u64) -> World {
    let seed = format!("app.seed={seed}");
    run_all_with(world, commands, &[&seed])
}

/// One command: from field 3,4 to 4,5.
pub(crate) const CARRY: &str = "carry 3,4,0 4,5,0";

/// What an errand without faults asks.
pub(crate) fn requests() -> Vec<String> {
    run(World::default(), &[CARRY]).bench.asked
}

/// The requests that are motions.
pub(crate) fn motions(requests: &[String]) -> Vec<usize> {
    let all = 0..requests.len();
    all.filter(|at| requests[*at] == Move::NAME).collect()
}
