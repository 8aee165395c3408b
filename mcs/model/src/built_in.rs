//! The models that come with the program: the files of `configs/models`, as they were when it was built.

use ctos_config::diagnostic::{Findings, Source};

use super::features::Model;
use super::file::{self, Inertias};

/// Their names.
pub const NAMES: [&str; 10] = [
    "puma560",
    "puma600",
    "transporter",
    "testbed9",
    "testbed18",
    "testbed9_gripper",
    "gripper",
    "hand",
    "puma560_gripper",
    "puma560_hand",
];

const TEXTS: [&str; 10] = [
    include_str!("../../../configs/models/puma560.toml"),
    include_str!("../../../configs/models/puma600.toml"),
    include_str!("../../../configs/models/transporter.toml"),
    include_str!("../../../configs/models/testbed9.toml"),
    include_str!("../../../configs/models/testbed18.toml"),
    include_str!("../../../configs/models/testbed9_gripper.toml"),
    include_str!("../../../configs/models/gripper.toml"),
    include_str!("../../../configs/models/hand.toml"),
    include_str!("../../../configs/models/puma560_gripper.toml"),
    include_str!("../../../configs/models/puma560_hand.toml"),
];

/// The file of a model.
#[must_use]
pub fn source(name: &str) -> Option<Source> {
    let mut all = NAMES.iter().zip(TEXTS);
    let (_, text) = all.find(|(known, _)| **known == name)?;
    Some(Source::new(format!("configs/models/{name}.toml"), text))
}

/// The model of that name; `None` when none is called so.
///
/// # Errors
/// What is wrong in its file; the tests of this crate hold that nothing is.
pub fn model(name: &str, inertias: Inertias) -> Option<Result<Model, Findings>> {
    source(name).map(|source| file::parse(&source, inertias))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_changed_line_makes_the_testbed_of_the_report_with_a_puma_600_on_the_right() {
        let own = source("testbed18").unwrap();
        let (before, last) = own.text().rsplit_once("model = \"puma560\"").unwrap();
        let text = format!("{before}model = \"puma600\"{last}");
        let changed = file::parse(&Source::new("testbed18.toml", text), Inertias::Identified);
        let changed = changed.unwrap();
        let of = |name: &str| model(name, Inertias::Identified).unwrap().unwrap();
        let reaches = |model: &Model, side: &str, q: &[f64]| {
            let mut data = model.data();
            let mut origin = |frame: &str| {
                let frame = model.frame(frame).unwrap();
                model.placement(&mut data, q, frame).origin
            };
            (origin(side) - origin(&format!("{side}_cart.mount"))).norm()
        };
        let mut q = [0.0; 18];
        q[13] = 0.4;
        let both = |model: &Model| ["left", "right"].map(|side| reaches(model, side, &q));
        assert_eq!(changed.dof(), 18);
        let (of_changed, of_own) = (both(&changed), both(&of("testbed18")));
        assert_eq!(of_changed[0], of_own[0]);
        assert!((of_changed[1] - of_own[1]).abs() > 1e-3, "{of_changed:?}");
    }

    #[test]
    fn every_file_is_a_model_with_as_many_joints_as_its_name_says() {
        for (name, joints) in NAMES.into_iter().zip([6, 6, 3, 9, 18, 11, 2, 9, 8, 15]) {
            for inertias in [Inertias::Identified, Inertias::Engine] {
                let model = model(name, inertias).unwrap().unwrap();
                assert_eq!((model.name(), model.dof()), (name, joints));
            }
        }
    }

    #[test]
    fn every_body_of_the_engine_set_is_a_possible_rigid_body() {
        for name in NAMES {
            for joint in model(name, Inertias::Engine).unwrap().unwrap().joints() {
                let principal = joint.body.inertia.symmetric_eigenvalues();
                assert!(
                    joint.body.mass > 0.0 && principal.min() > 0.0,
                    "{name} {}",
                    joint.name
                );
                assert!(
                    2.0 * principal.max() <= principal.sum() + 1e-12,
                    "{name} {}",
                    joint.name
                );
            }
        }
    }

    #[test]
    fn reflected_inertia_matches_the_published_column() {
        let expected = [0.78403, 2.32481, 0.57687, 0.19079, 0.17071, 0.19406];
        let model = model("puma560", Inertias::Identified).unwrap().unwrap();
        for (joint, expected) in model.joints().iter().zip(expected) {
            assert!((joint.motor.reflected_inertia() - expected).abs() < 5e-6);
        }
    }
}
