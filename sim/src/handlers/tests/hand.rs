//! The app of `configs/hand.toml` in virtual time: three fingertips pick a round piece up, weigh it and place it elsewhere.

use mcs::client::ReadSensors;
use mcs_hand::command::{
    Grasp, HandState, Held, LetGo, MoveFingers, Open, ReadHand, ReadHeld, Tripod,
};
use nalgebra::Vector3;

use super::{
    grasp::{ABOVE, down, go, run_app},
    *,
};

/// Where the piece stands at the start and in the end, m.
const PIECE: [f64; 3] = [0.5, -0.1, 0.425];
const TO: [f64; 3] = [0.5, 0.15, 0.425];
/// The fingers around it, rad.
const AROUND: [f64; 9] = [0.0, -0.35, 0.785, 0.0, -0.35, 0.785, 0.0, -0.35, 0.785];
/// How hard each fingertip presses, N.
const FORCE: f64 = 2.0;

/// What became of a step: what the hand says, where the piece is, and what the wrist feels, N.
#[derive(Debug, Clone)]
struct Step {
    name: &'static str,
    hand: HandState,
    at: Vector3<f64>,
    weight: f64,
}

async fn pick_and_place(cx: Context, steps: Arc<Mutex<Vec<Step>>>) {
    let hand = cx.task("hand").await.unwrap();
    let world = cx.task("world").await.unwrap();
    let arm = Manipulator::find(&cx, "mcs").await.unwrap();
    let client = cx.task("mcs").await.unwrap();
    let weigh = async || {
        let mut force = Vector3::zeros();
        for _ in 0..100 {
            cx.sleep(Duration::from_millis(9)).await;
            let read = cx.call(&client, ReadSensors {}).await.unwrap().numbers;
            force += Vector3::new(read[0], read[1], read[2]) / 100.0;
        }
        force.norm()
    };
    let note = async |name: &'static str, hand: HandState| {
        let weight = weigh().await;
        let scene = cx.call(&world, GetScene {}).await.unwrap();
        let at = scene.body("piece").unwrap().pose.translation.vector;
        let step = Step {
            name,
            hand,
            at,
            weight,
        };
        steps.lock().unwrap().push(step);
    };
    let state = async || cx.call(&hand, ReadHand {}).await.unwrap().unwrap();
    let order = Tripod {
        centre_m: [0.0, 0.0, 0.145],
        force_n: FORCE,
        speed: 0.3,
    };
    arm.acquire().await.unwrap();
    go(&arm, down(PIECE, ABOVE), PathKind::Joint).await;
    let around = MoveFingers {
        joints: AROUND.into(),
        speed: 1.0,
        time_s: Some(1.0),
    };
    cx.call(&hand, around).await.unwrap().unwrap();
    // Nothing is there yet.
    let empty = cx.call(&hand, order.clone()).await.unwrap().unwrap();
    note("empty", empty).await;
    let back = cx.call(&hand, LetGo { speed: 1.0 }).await.unwrap();
    note("back", back.unwrap()).await;
    go(&arm, down(PIECE, 0.0), PathKind::StraightLine).await;
    let grasped = cx.call(&hand, order).await.unwrap().unwrap();
    note("grasped", grasped).await;
    go(&arm, down(PIECE, ABOVE), PathKind::StraightLine).await;
    note("lifted", state().await).await;
    cx.sleep(Duration::from_secs(5)).await;
    note("held", state().await).await;
    go(&arm, down(TO, ABOVE), PathKind::StraightLine).await;
    note("carried", state().await).await;
    go(&arm, down(TO, 0.001), PathKind::StraightLine).await;
    let gone = cx.call(&hand, LetGo { speed: 0.5 }).await.unwrap();
    note("let go", gone.unwrap()).await;
    go(&arm, down(TO, ABOVE), PathKind::StraightLine).await;
    note("placed", state().await).await;
    arm.release().await.unwrap();
}

/// What became of each step with a piece of so much, kg.
fn run(mass: &str) -> Vec<Step> {
    let mass = format!("mass = {mass}");
    run_app("hand", ("mass = 0.1", mass.as_str()), |cx, steps| {
        Box::pin(pick_and_place(cx, steps))
    })
}

#[test]
fn three_fingertips_press_a_piece_as_asked_lift_hold_weigh_and_place_it_and_say_when_nothing_is_there()
 {
    let steps = run("0.1");
    let step = |name: &str| steps.iter().find(|step| step.name == name).unwrap();
    let holding = ["grasped", "lifted", "held", "carried"];
    for Step { name, hand, .. } in &steps {
        assert_eq!(hand.holds, holding.contains(name), "{name}: {hand:?}");
    }
    assert_eq!(step("empty").hand.touch_n, [0.0; 3]);
    for (joint, around) in step("back").hand.joints.iter().zip(AROUND) {
        assert!((joint - around).abs() < 5e-3, "{joint} for {around}");
    }
    for felt in step("grasped").hand.touch_n {
        assert!((felt - FORCE).abs() < 0.1 * FORCE, "{felt} N");
    }
    assert!((step("lifted").at.z - PIECE[2] - ABOVE).abs() < 2e-3);
    let slipped = (step("held").at - step("lifted").at).norm();
    assert!(slipped < 1e-3, "{slipped} m in 5 s");
    let weight = 0.1 * 9.81;
    for name in ["lifted", "held", "carried"] {
        let found = step(name).weight;
        assert!((found - weight).abs() < 0.02 * weight, "{name}: {found} N");
    }
    for name in ["back", "let go", "placed"] {
        assert!(step(name).weight < 0.02, "{:?}", step(name));
    }
    let off = step("placed").at - Vector3::from(TO);
    assert!(off.z.abs() < 1e-3 && off.norm() < 5e-3, "{off}");
}

#[test]
fn a_hand_whose_piece_is_too_heavy_says_that_it_holds_nothing_when_it_is_lifted() {
    // Friction carries 3 x 0.8 x 2 N, which is 0.49 kg.
    let steps = run("0.8");
    let holds = |name: &str| {
        let step = steps.iter().find(|step| step.name == name).unwrap();
        (step.hand.holds, step.at)
    };
    assert!(holds("grasped").0);
    let (held, at) = holds("lifted");
    assert!(!held);
    assert!((at.z - PIECE[2]).abs() < 2e-3, "{at}");
}

/// What the hand says when it is asked as a gripper: opened, closed on nothing, around the piece, with it in the air, and after it.
async fn as_a_gripper(cx: Context, steps: Arc<Mutex<Vec<Held>>>) {
    let hand = cx.task("hand").await.unwrap();
    let arm = Manipulator::find(&cx, "mcs").await.unwrap();
    let open = async |width_m: Option<f64>| {
        let order = Open {
            width_m,
            speed: 1.0,
        };
        cx.call(&hand, order).await.unwrap()
    };
    let close = async |force_n: Option<f64>| {
        let order = Grasp {
            force_n,
            speed: 0.3,
        };
        cx.call(&hand, order).await.unwrap().unwrap()
    };
    arm.acquire().await.unwrap();
    go(&arm, down(PIECE, ABOVE), PathKind::Joint).await;
    let mut all = vec![open(None).await.unwrap(), close(None).await];
    all.push(open(Some(0.05)).await.unwrap());
    assert!(open(Some(0.3)).await.is_err());
    go(&arm, down(PIECE, 0.0), PathKind::StraightLine).await;
    all.push(close(Some(FORCE)).await);
    go(&arm, down(PIECE, ABOVE), PathKind::StraightLine).await;
    all.push(cx.call(&hand, ReadHeld {}).await.unwrap().unwrap());
    go(&arm, down(PIECE, 0.001), PathKind::StraightLine).await;
    all.push(open(Some(0.05)).await.unwrap());
    arm.release().await.unwrap();
    *steps.lock().unwrap() = all;
}

#[test]
fn a_hand_does_what_a_gripper_is_asked_for_and_tells_how_wide_the_round_thing_is_that_it_holds() {
    let steps = run_app("hand", ("mass = 0.1", "mass = 0.1"), |cx, steps| {
        Box::pin(as_a_gripper(cx, steps))
    });
    let [straight, closed, round, grasped, lifted, gone] = steps.as_slice() else {
        panic!("{steps:?}");
    };
    // Fingers stand 40 mm from the middle, and their tips are balls of 9 mm.
    assert!((straight.width_m - 0.062).abs() < 1e-3, "{straight:?}");
    assert!(closed.width_m < 1e-3, "{closed:?}");
    for open in [straight, closed, round, gone] {
        assert!(!open.holds && open.force_n < 1e-9, "{open:?}");
    }
    for open in [round, gone] {
        assert!((open.width_m - 0.05).abs() < 1e-3, "{open:?}");
    }
    for held in [grasped, lifted] {
        assert!(held.holds && held.force_n > 0.5 * FORCE, "{held:?}");
        assert!((held.width_m - 0.04).abs() < 1e-3, "{held:?}");
    }
}
