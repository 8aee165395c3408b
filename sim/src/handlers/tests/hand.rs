//! The app of `configs/hand.toml` in virtual time: three fingertips grasp a round piece and let it go.

use mcs_hand::command::{HandState, LetGo, MoveFingers, ReadHand, Tripod};
use nalgebra::Vector3;

use super::{
    grasp::{ABOVE, down, go, run_app},
    *,
};

/// Where the piece stands, m.
const PIECE: [f64; 3] = [0.5, -0.1, 0.425];
/// The fingers around it, rad.
const AROUND: [f64; 9] = [0.0, -0.35, 0.785, 0.0, -0.35, 0.785, 0.0, -0.35, 0.785];
/// How hard each fingertip presses, N.
const FORCE: f64 = 2.0;

/// What became of a step: what the hand says, and where the piece is.
#[derive(Debug, Clone)]
struct Step {
    name: &'static str,
    hand: HandState,
    at: Vector3<f64>,
}

async fn grasp_and_let_go(cx: Context, steps: Arc<Mutex<Vec<Step>>>) {
    let hand = cx.task("hand").await.unwrap();
    let world = cx.task("world").await.unwrap();
    let arm = Manipulator::find(&cx, "mcs").await.unwrap();
    let note = async |name: &'static str, hand: HandState| {
        let scene = cx.call(&world, GetScene {}).await.unwrap();
        let at = scene.body("piece").unwrap().pose.translation.vector;
        steps.lock().unwrap().push(Step { name, hand, at });
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
    let gone = cx.call(&hand, LetGo { speed: 0.5 }).await.unwrap();
    note("let go", gone.unwrap()).await;
    go(&arm, down(PIECE, ABOVE), PathKind::StraightLine).await;
    note("placed", state().await).await;
    arm.release().await.unwrap();
}

#[test]
fn three_fingertips_press_a_piece_as_asked_let_it_go_and_say_so_when_nothing_is_there() {
    let steps = run_app("hand", ("mass = 0.1", "mass = 0.1"), |cx, steps| {
        Box::pin(grasp_and_let_go(cx, steps))
    });
    let step = |name: &str| steps.iter().find(|step| step.name == name).unwrap();
    for Step { name, hand, .. } in &steps {
        let holds = *name == "grasped";
        assert_eq!(hand.holds, holds, "{name}: {hand:?}");
    }
    assert_eq!(step("empty").hand.touch_n, [0.0; 3]);
    for (joint, around) in step("back").hand.joints.iter().zip(AROUND) {
        assert!((joint - around).abs() < 5e-3, "{joint} for {around}");
    }
    for felt in step("grasped").hand.touch_n {
        assert!((felt - FORCE).abs() < 0.2 * FORCE, "{felt} N");
    }
    let off = step("placed").at - Vector3::from(PIECE);
    assert!(off.z.abs() < 2e-3 && off.norm() < 0.01, "{off}");
}
