//! How the robot learns the map by itself: the hand goes through a grid around its place, and what is seen from each becomes an
//! example (SORMA technical report, section 2.2.4).

use std::time::Duration;

use ctos::task::{Context, HandlerError};
use nalgebra::{Isometry3, Matrix4, Point3, Translation3};
use serde::{Deserialize, Serialize};
use sorma::snapshot::{Place, Reader, Snapshot};

use crate::{
    map::{Example, grid},
    mover::Mover,
    wire::{BLOB, BlobRecord, LearnMap, LocateBlob},
};

/// How often it is looked for a picture.
const LOOK: Duration = Duration::from_millis(20);

/// How long an arm that has arrived is left alone, so that pictures are of where it is.
const STILL: Duration = Duration::from_millis(600);

/// A place without a ball is given up after this.
const PATIENCE: Duration = Duration::from_secs(20);

/// Arguments.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearnArgs {
    /// How far the map reaches to both sides, m along the axes of the tool.
    pub grid_m: [f64; 3],
    /// So many pictures are taken at each place.
    pub pictures: usize,
    /// Fraction of full speed between the places.
    pub speed: f64,
}

impl Default for LearnArgs {
    fn default() -> Self {
        Self {
            grid_m: [0.08, 0.08, 0.06],
            pictures: 12,
            speed: 0.3,
        }
    }
}

impl LearnArgs {
    /// The first key whose value cannot be, and what to give.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, String, &'static str)> {
        if !self.grid_m.iter().all(|half| (0.005..=0.5).contains(half)) {
            let value = format!("{:?}", self.grid_m);
            return Some(("grid_m", value, "give three numbers from 0.005 to 0.5"));
        }
        if !(self.speed > 0.0 && self.speed <= 1.0) {
            let value = self.speed.to_string();
            return Some(("speed", value, "give a number above 0, up to 1"));
        }
        (self.pictures == 0).then(|| ("pictures", "0".to_owned(), "give 1 or more"))
    }
}

/// How learning is.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub enum Learning {
    /// Nothing was learned yet.
    #[default]
    None,
    /// It is under way.
    Underway,
    /// The map is learned.
    Learned {
        /// Examples that it has.
        examples: usize,
        /// Places between them that it was held against.
        checked: usize,
        /// How well those are known: root mean square, m.
        rms_m: f64,
    },
    /// It came to nothing.
    Failed(String),
}

/// An arm that learns.
pub(crate) struct Learner<'a> {
    pub cx: &'a Context,
    pub args: LearnArgs,
    pub mover: Mover<'a>,
    /// The task that tells places from blobs.
    pub client: &'a str,
}

impl Learner<'_> {
    /// Takes the hand through the grid, learns the map, and holds it against places between.
    pub async fn learn(&self) -> Result<Learning, HandlerError> {
        let Self {
            cx, args, mover, ..
        } = self;
        let home = pose(&mover.arm.position().await?.base_t_tool);
        let client = cx.task(self.client).await?;
        let mut examples = Vec::new();
        let places = grid(args.grid_m);
        let all = places.len() as u64;
        for (done, place) in (0..).zip(places) {
            cx.progress(done, all, "learn", "the ball from each place of the grid");
            examples.push(self.example(&home, place).await?);
        }
        let request = LearnMap {
            examples: examples.clone(),
        };
        cx.call(&client, request).await?;
        let mut squares = Vec::new();
        for place in grid(args.grid_m.map(|half| 0.5 * half))
            .into_iter()
            .step_by(5)
        {
            let between = self.example(&home, place).await?;
            let seen = between.seen;
            let found = cx.call(&client, LocateBlob { seen }).await?;
            let (found, _) = found.ok_or("the map does not know a place between its examples")?;
            let off = Point3::from(found) - Point3::from(between.place);
            squares.push(off.norm_squared());
        }
        mover.move_to(&home).await?;
        Ok(Learning::Learned {
            examples: examples.len(),
            checked: squares.len(),
            rms_m: (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt(),
        })
    }

    /// What is seen where the ball is at a place from its nominal one, and where the hand should be, seen from there.
    async fn example(
        &self,
        home: &Isometry3<f64>,
        [x, y, z]: [f64; 3],
    ) -> Result<Example, HandlerError> {
        let Self {
            cx, args, mover, ..
        } = self;
        // The hand goes the other way.
        let there = home * Translation3::new(-x, -y, -z);
        mover.move_to(&there).await?;
        cx.sleep(STILL).await;
        let mut reader = Reader::open(&Place::of_app(&cx.app().name)?, BLOB)?;
        let head = reader.head();
        reader.seek(head);
        let (mut record, mut sums, mut taken) = (Snapshot::default(), [0.0; 4], 0_usize);
        let until = cx.now() + PATIENCE;
        while taken < args.pictures {
            if cx.now() >= until {
                let place = there.translation.vector;
                let text = format!("no whole ball is seen from {place:.3?}");
                return Err(HandlerError::new(text));
            }
            mover.go_on()?;
            cx.sleep(LOOK).await;
            while taken < args.pictures && reader.next(&mut record)?.is_some() {
                let blob = BlobRecord::from_floats(&record.floats);
                if let Some(blob) = blob.filter(|blob| blob.sighting.doubts == 0) {
                    let seen = blob.sighting.seen;
                    let numbers = [seen.u, seen.v, seen.radius, seen.spread];
                    for (sum, number) in sums.iter_mut().zip(numbers) {
                        *sum += number;
                    }
                    taken += 1;
                }
            }
        }
        // What counts is where the hand was.
        let measured = pose(&mover.arm.position().await?.base_t_tool);
        let nominal = measured.inverse() * Point3::from(home.translation.vector);
        Ok(Example {
            place: nominal.coords.into(),
            seen: sums.map(|sum| sum / taken as f64),
        })
    }
}

/// A pose from 16 numbers, row by row.
fn pose(rows: &[f64; 16]) -> Isometry3<f64> {
    let matrix = Matrix4::from_row_slice(rows);
    nalgebra::try_convert(matrix).unwrap_or_else(Isometry3::identity)
}
