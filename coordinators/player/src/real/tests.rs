use std::{path::Path, sync::Arc};

use ctos::config;
use mcs::{
    Joints,
    model::{Model, Placement},
    trajectory::{CartesianLimits, Goal, Pace, Planner, Route, Segment},
};
use mcs_collision::{guard::Surroundings, scene::Scene};
use vss::catalog::VssExpander;

use super::*;
use crate::{
    state::SPARE,
    table::MIDDLE,
    wire::{Hue, centre},
};

/// The arm of the app, and what stands around it.
struct Around {
    model: Arc<Model>,
    planner: Planner,
    scene: Scene,
    /// What each pair of solids keeps, m.
    margins: Vec<f64>,
    park: Joints,
}

impl Around {
    fn of_the_app() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/checkers-hands.toml");
        let app = config::load(&file, &[], &[("vss", &VssExpander)]);
        let app = app.unwrap_or_else(|found| panic!("{found}"));
        let model = Arc::new(mcs::manipulator(&app).unwrap());
        let args = |task: &str| &app.task(task).unwrap().args;
        let guard = args("servo_arm").get("guards.collision.args").unwrap();
        let around = Surroundings::read(guard).unwrap();
        let base = (Arc::clone(&model), Placement::identity());
        let scene = Scene::new([base], around.room.clone(), around.margin);
        let margin = |[solid, piece]: &[String; 2]| {
            let near = |own: &&(String, String, f64)| own.0 == *solid && own.1 == *piece;
            around
                .near
                .iter()
                .find(near)
                .map_or(around.margin, |own| own.2)
        };
        let margins = scene.names().iter().map(margin).collect();
        let real: ArmArgs = args("robot").get("real").unwrap().parse().unwrap();
        Self {
            planner: Planner::new(Arc::clone(&model), CartesianLimits::default(), 0.018).unwrap(),
            model,
            scene,
            margins,
            park: arm::radians(&real.park_deg),
        }
    }

    /// The way, and where it ends.
    fn way(
        &mut self,
        from: &Joints,
        to: Isometry3<f64>,
        path: PathKind,
    ) -> Option<(Segment, Joints)> {
        let route = Route {
            goal: Goal::Pose(to),
            path,
            pace: Pace::new(0.3, None),
            elbow: None,
        };
        self.planner.segment(from, &route).ok()
    }

    /// Whether a way keeps clear of everything.
    fn is_clear(&mut self, from: &Joints, way: &Segment) -> bool {
        let (mut solver, mut distances) = (self.planner.solver().clone(), Vec::new());
        let (mut near, margins) = (*from, &self.margins);
        (0..=40).all(|step| {
            let time = way.duration() * f64::from(step) / 40.0;
            near = way.at(&mut solver, time, &near).unwrap().position;
            self.scene.distances(&near, &mut distances);
            distances
                .iter()
                .zip(margins)
                .all(|(off, least)| off >= least)
        })
    }

    /// Whether the fingers get down there from where the arm waits, and up again, in some turn.
    fn reaches(&mut self, stand: Stand) -> bool {
        let mut park = self.park;
        // The arm has swung to this side.
        let [x, y] = stand.at;
        park[0] = y.atan2(x);
        TURNS_DEG.iter().any(|turn| {
            let down = stand.pose(*turn);
            let above = self.way(&park, at_height(down, TRAVEL_M), PathKind::Joint);
            let Some((there, over)) = above else {
                return false;
            };
            let down = self.way(&over, down, PathKind::StraightLine);
            down.is_some_and(|(down, _)| {
                self.is_clear(&park, &there) && self.is_clear(&over, &down)
            })
        })
    }
}

#[test]
fn every_square_heap_and_spare_disc_is_reached_clear_of_everything_when_the_board_is_in_the_middle()
{
    let mut around = Around::of_the_app();
    assert_eq!(around.model.dof(), 6);
    let errand = |spot: Spot, below: u8| Errand {
        number: 1,
        from: spot,
        to: spot,
        discs: 1,
        below: [below; 2],
        push: false,
    };
    let mut all = Vec::new();
    // The disc, and one that is set on it.
    for below in 0..2 {
        all.extend((0..32).map(|square| errand(Spot::Board(centre(square)), below)));
        for hue in [Hue::Light, Hue::Dark] {
            all.extend((0..12).map(|place| errand(Spot::Tray(hue, place), below)));
        }
    }
    for hue in [Hue::Light, Hue::Dark] {
        all.extend((0..SPARE).map(|below| errand(Spot::Spare(hue), below)));
    }
    let missed = all.iter().filter(|errand| {
        let [stand, _] = Stand::both(errand, &errand.ends(&MIDDLE));
        !around.reaches(stand)
    });
    let missed: Vec<_> = missed.map(|errand| (errand.from, errand.below)).collect();
    assert!(missed.is_empty(), "{missed:?}");
}

#[test]
fn fingers_that_are_open_around_a_disc_of_a_heap_touch_none_of_its_neighbours() {
    // A pad is 12 mm thick and 24 mm wide; a disc has a radius of 20 mm.
    let (reach, half) = (0.5 * GripperArgs::default().open_m + 0.012, 0.012);
    for hue in [Hue::Light, Hue::Dark] {
        let trays = (0..12).map(|place| Spot::Tray(hue, place).on_table(&MIDDLE));
        let spare = (0..SPARE).map(|below| Spot::Spare(hue).of_disc(&MIDDLE, below));
        let all: Vec<[f64; 2]> = trays.chain(spare).collect();
        for one in &all {
            for other in &all {
                let off = [0, 1].map(|axis| (one[axis] - other[axis]).abs());
                let apart = off[0].max(off[1]) > 1e-9;
                // Straight fingers, which are along y or x.
                let past = [0.02 + half, 0.02 + reach];
                let clear = |along: usize| off[along] > past[1] || off[1 - along] > past[0];
                assert!(!apart || clear(0) && clear(1), "{one:?} {other:?}");
            }
        }
    }
}
