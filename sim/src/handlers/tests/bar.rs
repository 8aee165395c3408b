//! The app of `configs/bar.toml` in virtual time: both arms of the testbed carry a bar, a closed chain of eighteen joints.

use mcs::{
    Joints,
    client::{Move, ReadSensors, Target},
    model::{
        Limits, Model, Placement, file,
        file::Inertias,
        inverse::{Preferences, Search},
    },
};
use mcs_hand::command::{Grasp, Open, ReadSqueeze, ReadTouch, SetSqueeze};
use nalgebra::{Matrix3, Vector3};

use super::{grasp::run_app, *};

/// Where the bar lies, its middle, m.
const BAR: [f64; 3] = [0.5, 0.6, 0.92];
/// Where the grippers hold it, m from its middle along it.
const HELD: f64 = 0.3;
/// How far it is lifted, and then moved along the tracks, m.
const UP: f64 = 0.1;
const ALONG: f64 = 0.1;
/// How hard it is pressed along itself, N.
const FORCE: f64 = 10.0;

/// What was found at one moment.
#[derive(Debug, Clone, Copy)]
struct Sample {
    stage: &'static str,
    /// How hard the bar is pressed along itself: as the law says, by the wrists, and by what presses on the jaws, N.
    squeezes: [f64; 3],
    /// What both wrists bear, N, upwards on the bar.
    weight: f64,
    /// Where its middle is, m, and how far it is turned, rad.
    at: Vector3<f64>,
    turned: f64,
}

/// The testbed as its servo knows it, and joint positions for both tips.
struct Reach {
    model: Model,
    q: Vec<f64>,
}

impl Reach {
    fn new() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../configs/models/testbed18_carrying_grippers.toml");
        let model = file::read(&path, Inertias::Engine).unwrap();
        let side = |turn: f64| [0.0, 0.0, 0.0, turn, 75.0, -180.0, 0.0, -75.0, 90.0];
        let degrees = [side(30.0), side(-30.0)].concat();
        Self {
            model,
            q: degrees.into_iter().map(f64::to_radians).collect(),
        }
    }

    /// Joint positions that have both grippers hold a bar so high above where it lies; carts stay where they are.
    fn above(&mut self, up: f64) -> Joints {
        let turn = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        for (tip, y) in [("left", -HELD), ("right", HELD)] {
            let q = self.q.clone();
            let held = self.model.clone().with_joints(|index, joint| {
                if index % 9 < 3 {
                    joint.limits = Limits {
                        lower: q[index],
                        upper: q[index],
                        ..joint.limits
                    };
                }
            });
            let goal = Placement {
                rotation: turn,
                origin: Vector3::new(BAR[0] + q[0], BAR[1] + y, BAR[2] + up),
            };
            let frame = held.frame(tip).unwrap();
            let mut search = Search::new(&held, frame, true, Preferences::default());
            self.q = search.solve(&held, &goal, &q).unwrap().to_vec();
        }
        Joints::try_from(self.q.as_slice()).unwrap()
    }

    /// The same with both carts moved on along their tracks.
    fn along(&mut self, way: f64) -> Joints {
        for track in [0, 9] {
            self.q[track] += way;
        }
        Joints::try_from(self.q.as_slice()).unwrap()
    }
}

async fn carry(cx: Context, log: Arc<Mutex<Vec<Sample>>>) {
    let world = cx.task("world").await.unwrap();
    let carry = cx.task("gripper_both").await.unwrap();
    let client = cx.task("both").await.unwrap();
    let grippers = [
        cx.task("gripper_left").await.unwrap(),
        cx.task("gripper_right").await.unwrap(),
    ];
    let both = Manipulator::find(&cx, "both").await.unwrap();
    let go = async |to: Joints, speed: f64| {
        let to = Move {
            target: Target::Joints(to),
            path: PathKind::Joint,
            speed,
            acceleration: None,
            elbow: None,
            blend: 0.0.into(),
            guards: Vec::new(),
        };
        both.go(to, Duration::from_secs(60)).await.unwrap();
    };
    let open = async || {
        for gripper in &grippers {
            let width_m = Some(0.08);
            let order = Open {
                width_m,
                speed: 1.0,
            };
            cx.call(gripper, order).await.unwrap().unwrap();
        }
    };
    // Looks on while the arms move.
    let stage = Arc::new(Mutex::new("above"));
    let (own, shown) = (cx.clone(), Arc::clone(&stage));
    cx.spawn(async move {
        loop {
            own.sleep(Duration::from_millis(9)).await;
            let Ok(read) = own.call(&client, ReadSensors {}).await else {
                return;
            };
            let along_jaws = async |arm: &str| {
                let arm = Some(arm.to_owned());
                let touches = own.call(&world, ReadTouch { arm }).await.unwrap();
                let jaws = touches.iter().filter(|touch| touch.link.contains("jaw"));
                jaws.map(|touch| touch.force_n[0]).sum::<f64>()
            };
            let (left, right) = (along_jaws("left").await, along_jaws("right").await);
            let law = own.call(&carry, ReadSqueeze {}).await.unwrap();
            let scene = own.call(&world, GetScene {}).await.unwrap();
            let pose = scene.body("bar").unwrap().pose;
            // Axis x of each gripper is along the bar from left to right, and z is down.
            let [one, other] = [&read.numbers[..6], &read.numbers[6..]];
            let wrists = 0.5 * (other[0] - one[0]);
            log.lock().unwrap().push(Sample {
                stage: *shown.lock().unwrap(),
                squeezes: [law.felt_n, wrists, 0.5 * (right - left)],
                weight: one[2] + other[2],
                at: pose.translation.vector,
                turned: pose.rotation.angle(),
            });
        }
    });
    let carry = cx.task("gripper_both").await.unwrap();
    let press = async |force_n: Option<f64>| {
        let order = SetSqueeze { force_n };
        cx.call(&carry, order).await.unwrap().unwrap();
    };
    let begin = |next: &'static str| *stage.lock().unwrap() = next;
    let wait = |seconds: f64| cx.sleep(Duration::from_secs_f64(seconds));
    let mut reach = Reach::new();
    both.acquire().await.unwrap();
    open().await;
    go(reach.above(0.12), 0.3).await;
    for up in [0.08, 0.04, 0.0] {
        go(reach.above(up), 0.3).await;
    }
    begin("grasp");
    for gripper in &grippers {
        let order = Grasp {
            force_n: Some(40.0),
            speed: 0.5,
        };
        assert!(cx.call(gripper, order).await.unwrap().unwrap().holds);
    }
    press(Some(FORCE)).await;
    wait(1.0).await;
    begin("lift");
    for step in 1..=5 {
        go(reach.above(UP * f64::from(step) / 5.0), 0.2).await;
    }
    wait(1.0).await;
    begin("held");
    wait(3.0).await;
    begin("moved");
    go(reach.along(ALONG), 0.3).await;
    wait(1.0).await;
    begin("held there");
    wait(1.0).await;
    begin("back");
    go(reach.along(-ALONG), 0.3).await;
    for step in (0..5).rev() {
        go(reach.above(UP * f64::from(step) / 5.0), 0.2).await;
    }
    // The force is there when the motion is answered, and stays until both let go.
    begin("set down");
    wait(0.5).await;
    begin("freed");
    press(None).await;
    wait(0.5).await;
    begin("let go");
    open().await;
    go(reach.above(0.12), 0.3).await;
    begin("placed");
    wait(0.5).await;
    both.release().await.unwrap();
}

#[test]
fn two_arms_as_one_manipulator_lift_a_bar_and_move_it_and_press_on_it_as_hard_as_they_shall() {
    let samples = run_app("bar", ("mass = 2.0", "mass = 2.0"), |cx, log| {
        Box::pin(carry(cx, log))
    });
    let of = |stage: &'static str| samples.iter().filter(move |sample| sample.stage == stage);
    let mean = |stage: &'static str, what: &dyn Fn(&Sample) -> f64| {
        let count = of(stage).count() as f64;
        of(stage).map(what).sum::<f64>() / count
    };
    // Three ways to tell, and each of them says the force that was asked for: at every moment within 3 %, noise and all, also
    // while the carts move, and when the bar stands again, until both let go. On the mean it is within 1 %.
    for stage in ["held", "moved", "held there", "set down"] {
        for way in 0..3 {
            let found = mean(stage, &|sample| sample.squeezes[way]);
            assert!((found - FORCE).abs() < 0.01 * FORCE, "{stage}: {found} N");
        }
        for sample in of(stage) {
            let off = |squeeze: &f64| (squeeze - FORCE).abs() < 0.03 * FORCE;
            assert!(sample.squeezes.iter().all(off), "{sample:?}");
        }
    }
    for stage in ["held", "held there"] {
        let weight = mean(stage, &|sample| sample.weight);
        assert!(
            (weight - 2.0 * 9.81).abs() < 0.02 * 2.0 * 9.81,
            "{weight} N"
        );
    }
    // Where it goes up and down its weight comes and goes by a quarter. Where it leaves the stand and meets it, the stand pushes it.
    for sample in of("lift").chain(of("back")) {
        let most = match sample.at.z > BAR[2] + 1e-3 {
            true => 0.04,
            false => 0.4,
        };
        let off = |squeeze: &f64| (squeeze - FORCE).abs() < most * FORCE;
        assert!(sample.squeezes.iter().all(off), "{sample:?}");
        assert!(sample.turned < 0.01, "{sample:?}");
    }
    let lies = Vector3::from(BAR);
    let (up, along) = (Vector3::z() * UP, Vector3::x() * ALONG);
    for (stage, place) in [
        ("held", lies + up),
        ("held there", lies + up + along),
        ("placed", lies),
    ] {
        let last = of(stage).next_back().unwrap();
        let off = (last.at - place).norm();
        assert!(off < 2e-3, "{stage}: {off} m");
    }
}

#[test]
fn the_shipped_requests_keep_both_grippers_as_far_apart_as_they_hold_the_bar() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/carry_bar.sor");
    let text = std::fs::read_to_string(path).unwrap();
    let ways = text
        .lines()
        .filter_map(|line| line.strip_prefix("mvpos.both EXEC joints FMSG 18"));
    let Reach { model, .. } = Reach::new();
    let (mut data, mut highest, mut farthest): (_, f64, f64) = (model.data(), 0.0, 0.0);
    for way in ways {
        let numbers = way.split_whitespace().map(|word| word.parse().unwrap());
        let q: Vec<f64> = numbers.collect();
        let tips = ["left", "right"].map(|tip| {
            let frame = model.frame(tip).unwrap();
            model.placement(&mut data, &q, frame)
        });
        let apart = tips[1].origin - tips[0].origin;
        let off = (apart - Vector3::new(0.0, 2.0 * HELD, 0.0)).norm();
        assert!(off < 1e-4, "{apart}");
        for tip in &tips {
            let down = tip.rotation.column(2).into_owned();
            assert!((down + Vector3::z()).norm() < 1e-4, "{down}");
        }
        highest = highest.max(tips[0].origin.z - BAR[2]);
        farthest = farthest.max(tips[0].origin.x - BAR[0]);
    }
    assert!((highest - 0.12).abs() < 1e-4 && (farthest - ALONG).abs() < 1e-4);
}
