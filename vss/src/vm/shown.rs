//! The monitor as viewers elsewhere see it: the last picture of each camera, made small, with the markers on it. Nothing is made
//! small while nobody follows, and only what the monitor shows then.

use std::{collections::BTreeMap, sync::Arc};

use ctos::task::Context;
use scene::{Found, Picture, Seen, Source, Stage, View, picture};

use super::Monitor;
use crate::command::{Mark, Shown};

/// What the monitor of this chassis shows.
pub(super) fn stage(cx: &Context) -> Stage {
    Stage::new(Wall {
        monitor: Monitor::of(cx),
        told: BTreeMap::new(),
    })
}

struct Wall {
    monitor: Arc<Monitor>,
    /// Of each camera, the picture that was told last and how many markers it had.
    told: BTreeMap<String, (u64, usize)>,
}

impl Source for Wall {
    fn view(&mut self) -> Option<View> {
        None
    }

    fn look(&mut self) -> Seen {
        // Clones share the pixels; whoever shows something does not wait for the rest.
        let shown: Vec<(String, Shown)> = {
            let shown = self.monitor.lock();
            let new = shown.iter().filter(|(camera, shown)| {
                let now = (shown.frame.number, shown.marks.len());
                self.told.get(*camera) != Some(&now)
            });
            new.map(|(camera, shown)| (camera.clone(), shown.clone()))
                .collect()
        };
        let mut seen = Seen::default();
        for (camera, shown) in shown {
            let now = (shown.frame.number, shown.marks.len());
            seen.pictures.extend(small(&camera, &shown));
            self.told.insert(camera, now);
        }
        seen
    }
}

/// A picture for viewers; none of a frame that is not whole.
fn small(camera: &str, shown: &Shown) -> Option<Picture> {
    let frame = &shown.frame;
    let (width, height) = (frame.width, frame.height);
    let side = picture::MOST_SIDE;
    let (size, pixels) = picture::thinned((width, height), &frame.grey(), side)?;
    let marks = shown.marks.iter().map(|Mark { u, v, sd }| Found {
        at: [*u, *v],
        sd: sd.iter().all(|sd| sd.is_finite()).then_some(*sd),
    });
    Some(Picture {
        camera: camera.to_owned(),
        number: frame.number,
        at_ns: u64::try_from(frame.stamp.as_nanos()).unwrap_or(u64::MAX),
        taken: [u32::try_from(width).ok()?, u32::try_from(height).ok()?],
        size,
        pixels: pixels.into(),
        marks: marks.collect(),
        drawing: shown.drawing.clone(),
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::frame::Frame;

    fn shown(number: u64, marks: Vec<Mark>) -> Shown {
        let frame = Frame {
            number,
            stamp: Duration::from_millis(7),
            ..Frame::grey8(640, 480, vec![50; 640 * 480])
        };
        Shown {
            frame,
            marks,
            drawing: scene::Drawing::default(),
        }
    }

    #[test]
    fn each_picture_is_told_once_and_again_with_what_was_found_in_it() {
        let monitor = Arc::new(Monitor::default());
        let mut wall = Wall {
            monitor: monitor.clone(),
            told: BTreeMap::new(),
        };
        assert!(wall.look().pictures.is_empty());
        monitor.lock().insert("west".to_owned(), shown(3, vec![]));
        monitor.lock().insert("east".to_owned(), shown(8, vec![]));
        assert_eq!(wall.look().pictures.len(), 2);
        assert!(wall.look().pictures.is_empty());
        let mark = Mark {
            u: 100.25,
            v: 31.5,
            sd: [0.1, 0.2],
        };
        let marked = shown(3, vec![mark]);
        monitor.lock().insert("west".to_owned(), marked);
        let pictures = wall.look().pictures;
        assert_eq!(pictures.len(), 1);
        let picture = &pictures[0];
        assert_eq!((picture.taken, picture.size), ([640, 480], [320, 240]));
        assert_eq!(picture.at_ns, 7_000_000);
        assert_eq!(picture.pixels.len(), 320 * 240);
        assert_eq!(picture.marks[0].at, [100.25, 31.5]);
        assert_eq!(picture.marks[0].sd, Some([0.1, 0.2]));
    }
}
