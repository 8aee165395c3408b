//! What the cameras of the room and that on the hand see.

use std::time::Duration;

use nalgebra::{Point3, Vector3};
use vss::{
    command::{DiskOffset, DiskReport, DiskSight, Outcome as Vss, VisionError},
    visual_jacobian::{Correction, Seen},
};
use vss_board::{discs::SeenDisc, pose::BoardPose};

use super::{Place, Room, World};
use crate::carry::sight::Overview;

impl World {
    /// What the camera on the hand sees with so many pictures.
    pub(super) fn overview_by_hand(&mut self, pictures: usize) -> Result<Overview, VisionError> {
        assert!(pictures >= 2, "one picture tells no heights");
        let pose = (self.joints[0].to_degrees() / 10.0).round() as usize;
        if self.blind_poses.contains(&pose) {
            let text = format!("no board is seen from pose {pose}");
            return Err(VisionError::new(Vss::Unseen, text));
        }
        let room = std::mem::replace(&mut self.room, Room::Well);
        let seen = self.overview();
        self.room = room;
        seen
    }

    /// What the cameras see.
    pub(super) fn overview(&mut self) -> Result<Overview, VisionError> {
        if self.room == Room::Not {
            return Err(VisionError::new(Vss::Fault, "camera `left`: covered"));
        }
        self.looks += 1;
        if self.looks > self.is_cleared_after {
            self.others.clear();
        }
        if self.looks > self.dark_from {
            return Err(VisionError::new(Vss::Unseen, "no camera sees the board"));
        }
        let pose = self.board.pose();
        let squint = match self.at_answers.is_empty() {
            true => Vector3::zeros(),
            false => self.squint,
        };
        let disc = |at: &Point3<f64>, colour: usize| SeenDisc {
            at: pose.inverse() * (at + squint),
            colour,
            rms_px: 0.1,
            sd_m: 1e-4,
            cameras: 2,
        };
        let mut discs: Vec<SeenDisc> = self.others.iter().map(|at| disc(at, 1)).collect();
        if let Place::At(at) = &self.thing {
            discs.push(disc(at, 0));
        }
        Ok(Overview {
            board: BoardPose {
                base_t_board: pose,
                sd: [1e-4; 6],
                rms_px: 0.1,
                corners: 98,
                cameras: match self.room {
                    Room::InDoubt => vec!["right".to_owned()],
                    _ => vec!["left".to_owned(), "right".to_owned()],
                },
            },
            discs,
            bare: vec![Some(if self.clutter { 0.1 } else { 1.0 })],
            doubts: Vec::new(),
        })
    }

    /// What the camera on the hand sees.
    pub(super) fn offset(&mut self, request: &DiskOffset) -> Result<DiskReport, VisionError> {
        let Place::At(at) = self.thing else {
            return Err(VisionError::new(Vss::Unseen, "no disc is there"));
        };
        let off = self.tool.inverse() * at;
        let (by, true_by) = match request.taught {
            Some([x, y]) => ([-x, -y], [off.x, off.y]),
            None if self.taught < 4 => {
                return Err(VisionError::new(Vss::Refused, "4 examples are needed"));
            }
            None => ([off.x, off.y], [off.x, off.y]),
        };
        // What is taught is true.
        assert!((by[0] - true_by[0]).hypot(by[1] - true_by[1]) < 1e-6);
        self.taught += usize::from(request.taught.is_some());
        let correction = request.taught.is_none().then_some(Correction {
            by,
            sd: [1e-4; 2],
            error: 0.0,
            good: true,
        });
        Ok(DiskReport {
            camera: request.camera.clone(),
            disk: DiskSight {
                seen: Seen {
                    u: 250.0,
                    v: 250.0,
                    radius: 43.0,
                },
                sd_px: [0.1; 2],
                examples: self.taught.min(4),
                correction,
            },
            stamp: Duration::ZERO,
            frame: 0,
        })
    }
}
