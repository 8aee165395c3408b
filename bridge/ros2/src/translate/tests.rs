use scene::{Found, Layer, Mark, Moved, Number, Part, Pose, Solid, View};

use super::*;
use crate::messages::decode;

fn args(toml: &str) -> Args {
    let source = ctos::diagnostic::Source::new("app.toml", toml);
    let mut findings = ctos::diagnostic::Findings::new();
    let node = ctos::config::Node::from_toml(&source, &mut findings);
    assert!(findings.is_empty(), "{findings}");
    node.parse().unwrap()
}

fn translator(toml: &str) -> Translator {
    Translator::new(args(toml), 1_000_000_000)
}

fn view(layer: Layer) -> View {
    let number = |name: &str| Number {
        name: name.to_owned(),
        unit: String::new(),
        resolution: 0.0,
    };
    let link = Part {
        name: "link1".to_owned(),
        numbers: ["joint1", "error", "velocity", "effort"].map(number).into(),
        ..Part::default()
    };
    let corners = [
        [-0.5, -0.25, 1.0],
        [0.5, -0.25, 1.0],
        [0.5, 0.25, 1.0],
        [-0.5, 0.25, 1.0],
    ];
    let camera = Part {
        name: "eye".to_owned(),
        solids: vec![Solid::Frustum {
            corners,
            camera: "left-1".to_owned(),
        }],
        ..Part::default()
    };
    View {
        layer,
        parts: vec![link, camera],
    }
}

fn batch(at_ns: u64, view: Option<View>) -> Batch {
    let moved = |part, numbers: &[f64]| Moved {
        part,
        pose: Pose {
            at: [1.0, 2.0, 3.0],
            ..Pose::default()
        },
        numbers: numbers.to_vec(),
    };
    Batch {
        mark: Mark { run: 0, seq: 1 },
        at_ns,
        view,
        moved: vec![moved(0, &[0.5, 0.0, f64::NAN, 7.0]), moved(1, &[])],
        said: Some(Said {
            words: "stopped".to_owned(),
            fault: true,
            job: None,
        }),
        pictures: Vec::new(),
    }
}

fn picture(at_ns: u64, marks: Vec<Found>) -> Batch {
    let picture = Picture {
        camera: "left-1".to_owned(),
        number: 1,
        at_ns,
        taken: [8, 4],
        size: [4, 2],
        pixels: vec![0, 1, 2, 3, 4, 5, 6, 7].into(),
        marks,
    };
    Batch {
        view: None,
        moved: Vec::new(),
        said: None,
        pictures: vec![picture],
        ..batch(at_ns, None)
    }
}

fn names(all: &[Told]) -> Vec<&str> {
    all.iter().map(|told| told.name.as_str()).collect()
}

#[test]
fn what_was_measured_is_told_under_the_usual_names() {
    let mut translator = translator("namespace = \"cell\"");
    let all = translator.take("state", batch(2_000_000_003, Some(view(Layer::Measured))));
    assert_eq!(names(&all), ["/cell/joint_states", "/tf", "/diagnostics"]);
    let joints: JointState = decode(&all[0].bytes).unwrap();
    assert_eq!(joints.header.stamp, Time { sec: 3, nanosec: 3 });
    assert_eq!(
        (&joints.name[..], &joints.position[..]),
        (&["joint1".to_owned()][..], &[0.5][..])
    );
    assert!(joints.velocity[0].is_nan() && joints.effort == [7.0]);
    let frames: TFMessage = decode(&all[1].bytes).unwrap();
    let children: Vec<_> = frames
        .transforms
        .iter()
        .map(|one| &one.child_frame_id[..])
        .collect();
    assert_eq!(children, ["state/link1", "state/eye"]);
    assert_eq!(frames.transforms[0].header.frame_id, "world");
    assert_eq!(frames.transforms[0].translation, [1.0, 2.0, 3.0]);
    let said: DiagnosticArray = decode(&all[2].bytes).unwrap();
    assert_eq!(
        (said.status[0].level, &said.status[0].message[..]),
        (2, "stopped")
    );
}

#[test]
fn what_a_simulator_knows_is_told_only_where_it_is_asked_for() {
    let truth = || batch(1, Some(view(Layer::Truth)));
    assert_eq!(translator("").take("truth", truth()), []);
    let mut asked = translator("publish.\"truth/tf\".frames = [\"truth\"]");
    assert_eq!(names(&asked.take("truth", truth())), ["/truth/tf"]);
    let measured = batch(1, Some(view(Layer::Measured)));
    assert_eq!(asked.take("state", measured), []);
}

#[test]
fn a_picture_has_its_lens_beside_it_in_the_cameras_frame_and_comes_once() {
    let mut translator = translator("");
    let all = translator.take("vision", picture(5, Vec::new()));
    assert_eq!(names(&all), ["/left_1/image_raw"]);
    let all = translator.take("rig", batch(6, Some(view(Layer::Measured))));
    assert!(
        names(&all).contains(&"/left_1/camera_info"),
        "as soon as it is known"
    );
    let all = translator.take("vision", picture(7, Vec::new()));
    assert_eq!(names(&all), ["/left_1/image_raw", "/left_1/camera_info"]);
    let image: Image = decode(&all[0].bytes).unwrap();
    assert_eq!(
        (image.width, image.height, image.step, image.data.len()),
        (4, 2, 4, 8)
    );
    assert_eq!(image.header.frame_id, "rig/eye");
    let info: CameraInfo = decode(&all[1].bytes).unwrap();
    assert_eq!(info.header, image.header);
    // 4 px over 1 m at 1 m; the middle of the picture is between the second and the third pixel.
    assert_eq!(
        (info.k[0], info.k[2], info.k[4], info.k[5]),
        (4.0, 1.5, 4.0, 0.5)
    );
    let mark = Found {
        at: [1.0, 1.0],
        sd: None,
    };
    assert_eq!(translator.take("vision", picture(7, vec![mark])), []);
}

#[test]
fn who_comes_late_is_told_everything_again_with_the_present_time() {
    let mut translator = translator("");
    translator.take("state", batch(1, Some(view(Layer::Measured))));
    let bridge = DiagnosticStatus {
        level: 0,
        name: "bridge".to_owned(),
        message: String::new(),
        hardware_id: String::new(),
        values: Vec::new(),
    };
    let all = translator.whole(9_000_000_000, bridge);
    assert_eq!(names(&all), ["/joint_states", "/tf", "/diagnostics"]);
    let joints: JointState = decode(&all[0].bytes).unwrap();
    assert_eq!(joints.header.stamp.sec, 10);
    let said: DiagnosticArray = decode(&all[2].bytes).unwrap();
    let told: Vec<_> = said.status.iter().map(|status| &status.name[..]).collect();
    assert_eq!(told, ["state", "bridge"]);
}
