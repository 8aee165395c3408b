use foxglove::{Decode, messages::CameraCalibration};
use scene::{Found, Mark, Number, Pose, Said, Solid, View};
use zune_jpeg::{JpegDecoder, zune_core::bytestream::ZCursor};

use super::*;

const NAN: f64 = f64::NAN;

fn number(name: &str, unit: &str) -> Number {
    Number {
        name: name.to_owned(),
        unit: unit.to_owned(),
        resolution: 0.0,
    }
}

fn arm() -> View {
    let base = Part {
        name: "base".to_owned(),
        solids: vec![Solid::Axes(0.1)],
        ..Part::default()
    };
    let link = Part {
        name: "link1".to_owned(),
        parent: Some("base".to_owned()),
        solids: vec![Solid::Block {
            pose: Pose::default(),
            half: [0.1, 0.2, 0.3],
        }],
        colour: [255, 0, 51],
        numbers: vec![
            number("joint1", "rad"),
            number("error", "rad"),
            number("velocity", "rad/s"),
            number("effort", "N m"),
        ],
        ..Part::default()
    };
    View {
        parts: vec![base, link],
        ..View::default()
    }
}

fn moved(part: u32, x: f64, numbers: &[f64]) -> Moved {
    Moved {
        part,
        pose: Pose {
            at: [x, 0.0, 0.0],
            ..Pose::default()
        },
        numbers: numbers.to_vec(),
    }
}

fn batch(at_ns: u64, view: Option<View>, moved: Vec<Moved>) -> Batch {
    Batch {
        mark: Mark { run: 0, seq: at_ns },
        at_ns,
        view,
        moved,
        said: None,
        pictures: Vec::new(),
    }
}

fn picture(at_ns: u64, marks: Vec<Found>) -> Picture {
    let pixels: Vec<u8> = (0..32 * 16).map(|at| (at % 32 * 8) as u8).collect();
    Picture {
        camera: "west".to_owned(),
        number: at_ns,
        at_ns,
        taken: [64, 32],
        size: [32, 16],
        pixels: pixels.into(),
        marks,
        drawing: scene::Drawing::default(),
    }
}

/// The message on `channel`, of which there is one.
fn only<M: Decode<Error = E>, E: std::fmt::Debug>(sent: &[Sent], channel: &str) -> M {
    let on: Vec<&Sent> = sent.iter().filter(|sent| sent.channel == channel).collect();
    let [one] = on[..] else {
        panic!("{channel}: {sent:?}");
    };
    assert_eq!(one.schema.language, "protobuf");
    M::decode(&one.bytes[..]).unwrap()
}

fn channels(sent: &[Sent]) -> Vec<&str> {
    sent.iter().map(|sent| sent.channel.as_str()).collect()
}

#[test]
fn each_change_tells_where_all_parts_are_and_the_parts_only_when_there_are_others() {
    let mut translator = Translator::default();
    let parts = vec![moved(0, 1.0, &[]), moved(1, 2.0, &[0.5, NAN, 0.25, -3.0])];
    let told = translator.take("motion", batch(1_500_000_000, Some(arm()), parts));
    let told = told.unwrap();
    let all = [
        "/solids/motion",
        "/tf/motion",
        "/joints/motion",
        "/numbers/motion",
    ];
    assert_eq!(channels(&told), all);
    let scene: SceneUpdate = only(&told, "/solids/motion");
    assert_eq!(scene.deletions.len(), 1);
    assert_eq!(scene.entities[1].frame_id, "motion/link1");
    assert_eq!(scene.entities[1].cubes[0].size.unwrap().z, 0.6);
    let colour = scene.entities[1].cubes[0].color.unwrap();
    assert_eq!(
        [colour.r, colour.g, colour.b, colour.a],
        [1.0, 0.0, 0.2, 1.0]
    );

    let later = batch(
        2_000_000_000,
        None,
        vec![moved(1, 2.5, &[0.6, 0.0, 0.1, 0.0])],
    );
    let told = translator.take("motion", later).unwrap();
    assert_eq!(channels(&told), all[1..]);
    let places: FrameTransforms = only(&told, "/tf/motion");
    let at = |index: usize| {
        let one = &places.transforms[index];
        assert_eq!(one.parent_frame_id, WORLD);
        (one.child_frame_id.as_str(), one.translation.unwrap().x)
    };
    assert_eq!(
        (at(0), at(1)),
        (("motion/base", 1.0), ("motion/link1", 2.5))
    );
    assert_eq!(places.transforms[1].timestamp, Some(Timestamp::new(2, 0)));
}

#[test]
fn joints_have_what_is_known_of_them_and_numbers_their_units() {
    let mut translator = Translator::default();
    let parts = vec![moved(1, 2.0, &[0.5, NAN, 0.25, NAN])];
    let told = translator
        .take("motion", batch(0, Some(arm()), parts))
        .unwrap();
    let joints: JointStates = only(&told, "/joints/motion");
    let [joint] = &joints.joints[..] else {
        panic!("{joints:?}");
    };
    assert_eq!(joint.name, "joint1");
    let known = (joint.position, joint.velocity, joint.effort);
    assert_eq!(known, (Some(0.5), Some(0.25), None));
    let numbers = told.iter().find(|sent| sent.channel == "/numbers/motion");
    let numbers: Value = serde_json::from_slice(&numbers.unwrap().bytes).unwrap();
    let link = &numbers["link1"];
    assert_eq!(link["velocity_rad_per_s"], 0.25);
    assert_eq!(link["joint1_rad"], 0.5);
    assert!(link["effort_N_m"].is_null(), "{numbers}");
}

#[test]
fn who_comes_later_is_told_all_of_it_but_pictures() {
    let mut translator = Translator::default();
    assert_eq!(translator.whole("motion").unwrap(), []);
    let parts = vec![moved(0, 1.0, &[])];
    let mut first = batch(0, Some(arm()), parts);
    first.said = Some(Said {
        words: "stopped".to_owned(),
        fault: true,
        job: None,
    });
    first.pictures = vec![picture(0, Vec::new())];
    let mut told = translator.take("motion", first).unwrap();
    told.retain(|sent| !sent.channel.starts_with("/camera"));
    assert_eq!(translator.whole("motion").unwrap(), told);
    let said: Log = only(&told, "/said/motion");
    assert_eq!((said.level, said.message.as_str()), (3, "stopped"));
}

#[test]
fn a_picture_is_the_same_for_who_decodes_it_and_marks_are_in_its_pixels() {
    let found = Found {
        at: [31.5, 15.5],
        sd: Some([1.0, 2.0]),
    };
    let mut translator = Translator::default();
    let mut one = batch(0, None, Vec::new());
    one.pictures = vec![picture(7, vec![found])];
    let told = translator.take("monitor", one).unwrap();
    let image: CompressedImage = only(&told, "/camera/west/image");
    assert_eq!(
        (image.frame_id.as_str(), image.format.as_str()),
        ("camera/west", "jpeg")
    );
    let pixels = JpegDecoder::new(ZCursor::new(&image.data))
        .decode()
        .unwrap();
    let taken = picture(7, Vec::new());
    // The decoder gives three equal bytes a pixel.
    assert_eq!(pixels.len(), 3 * taken.pixels.len());
    for (decoded, pixel) in pixels.iter().step_by(3).zip(taken.pixels.iter()) {
        assert!(decoded.abs_diff(*pixel) < 12, "{decoded} for {pixel}");
    }
    let marks: ImageAnnotations = only(&told, "/camera/west/marks");
    let circle = &marks.circles[0];
    // 64 px became 32: the edge between pixels 31 and 32 is that between 15 and 16.
    assert_eq!(circle.position.map(|at| (at.x, at.y)), Some((15.5, 7.5)));
    assert_eq!(circle.diameter, 6.0);
}

#[test]
fn a_task_that_shows_pictures_alone_tells_of_no_places_and_one_whose_parts_are_gone_says_so() {
    let mut translator = Translator::default();
    let mut first = batch(0, Some(View::default()), Vec::new());
    first.pictures = vec![picture(7, Vec::new())];
    let told = translator.take("monitor", first).unwrap();
    assert_eq!(
        channels(&told),
        ["/camera/west/image", "/camera/west/marks"]
    );
    let parts = vec![moved(0, 1.0, &[])];
    translator
        .take("motion", batch(0, Some(arm()), parts))
        .unwrap();
    let gone = translator.take("motion", batch(1, Some(View::default()), Vec::new()));
    let scene: SceneUpdate = only(&gone.unwrap(), "/solids/motion");
    assert_eq!((scene.deletions.len(), scene.entities.len()), (1, 0));
}

#[test]
fn pictures_come_five_times_a_second_at_most_and_marks_that_came_late_once_more() {
    let mut translator = Translator::default();
    let mut images = 0;
    for at in 0..50_u64 {
        let mut one = batch(at, None, Vec::new());
        one.pictures = vec![picture(at * 40_000_000, Vec::new())];
        let told = translator.take("monitor", one).unwrap();
        images += channels(&told)
            .iter()
            .filter(|on| on.ends_with("/image"))
            .count();
    }
    assert_eq!(images, 10);
    let mut again = batch(50, None, Vec::new());
    let found = Found {
        at: [1.0, 1.0],
        sd: None,
    };
    again.pictures = vec![picture(45 * 40_000_000, vec![found])];
    let told = translator.take("monitor", again).unwrap();
    assert_eq!(channels(&told), ["/camera/west/marks"]);
}

#[test]
fn a_computed_camera_is_told_with_the_size_of_its_pictures_and_theirs_is_its_frame() {
    let corners = [
        [-0.4, -0.2, 1.0],
        [0.4, -0.2, 1.0],
        [0.4, 0.2, 1.0],
        [-0.4, 0.2, 1.0],
    ];
    let view = View {
        parts: vec![Part {
            name: "west".to_owned(),
            solids: vec![Solid::Frustum {
                corners,
                camera: "west".to_owned(),
            }],
            ..Part::default()
        }],
        ..View::default()
    };
    let truth = View {
        layer: Layer::Truth,
        ..view.clone()
    };
    let mut translator = Translator::default();
    for (source, view) in [("a_world", truth), ("dom", view)] {
        let told = translator.take(source, batch(1, Some(view), vec![moved(0, 0.0, &[])]));
        assert!(!channels(&told.unwrap()).contains(&"/camera/west/calibration"));
    }
    let mut one = batch(2, None, Vec::new());
    one.pictures = vec![picture(2, Vec::new())];
    let told = translator.take("monitor", one).unwrap();
    let image: CompressedImage = only(&told, "/camera/west/image");
    let lens: CameraCalibration = only(&told, "/camera/west/calibration");
    assert_eq!(
        (image.frame_id.as_str(), lens.frame_id.as_str()),
        ("dom/west", "dom/west")
    );
    assert_eq!((lens.width, lens.height), (32, 16));
    // 32 px over 0.8 at a depth of 1.
    assert!((lens.k[0] - 40.0).abs() < 1e-9 && (lens.k[2] - 15.5).abs() < 1e-9);
}

#[test]
fn a_picture_without_its_pixels_is_an_error_that_names_it_and_nothing_else_is_lost() {
    let mut one = batch(0, Some(arm()), vec![moved(0, 1.0, &[])]);
    one.pictures = vec![Picture {
        size: [33, 16],
        ..picture(5, Vec::new())
    }];
    let mut translator = Translator::default();
    let error = translator.take("motion", one).unwrap_err();
    assert!(
        error.to_string().contains("picture 5 of camera `west`"),
        "{error}"
    );
    let whole = translator.whole("motion").unwrap();
    assert!(channels(&whole).contains(&"/tf/motion"));
}

#[test]
fn an_arrow_goes_along_the_force_that_is_measured_and_away_when_there_is_none() {
    let wrist = Part {
        name: "wrist".to_owned(),
        solids: vec![Solid::Vector {
            first: 1,
            scale: 0.01,
            turns: false,
        }],
        numbers: ["t", "x", "y", "z"].map(|name| number(name, "N")).into(),
        ..Part::default()
    };
    let view = View {
        parts: vec![wrist],
        ..View::default()
    };
    let mut translator = Translator::default();
    let mut arrows = |at_ns: u64, view: Option<View>, numbers: &[f64]| {
        let told = batch(at_ns, view, vec![moved(0, 0.5, numbers)]);
        let all = translator.take("arm", told).unwrap();
        let found = all.iter().find(|sent| sent.channel == "/vectors/arm");
        let update = SceneUpdate::decode(found.unwrap().bytes.as_slice()).unwrap();
        let [entity] = &update.entities[..] else {
            panic!("{update:?}");
        };
        assert_eq!(
            (entity.id.as_str(), entity.frame_id.as_str()),
            ("wrist", "arm/wrist")
        );
        entity.arrows.clone()
    };
    let [up] = &arrows(1, Some(view), &[9.0, 0.0, 0.0, 20.0])[..] else {
        panic!("no arrow");
    };
    assert!((up.shaft_length + up.head_length - 0.2).abs() < 1e-9);
    // Arrows point along x: a quarter turn about -y leads to z.
    let turn = up.pose.as_ref().unwrap().orientation.unwrap();
    assert!((turn.y + 0.5_f64.sqrt()).abs() < 1e-9 && (turn.w - 0.5_f64.sqrt()).abs() < 1e-9);
    assert_eq!(arrows(2, None, &[9.0, 0.0, 0.0, 0.0]), []);
    assert_eq!(arrows(3, None, &[9.0, NAN, 1.0, 1.0]), []);
}
