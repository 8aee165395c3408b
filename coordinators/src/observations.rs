//! What a calibration collects, position by position, and when it is clear that it leads nowhere. Knows
//! no task and no net.

use ctos::task::HandlerError;
use vss::calibrate::LightPoint;

use crate::objects::{CameraTable, Observations, ReachedPosition, Spots, UnusedPosition};

/// After so many positions out of reach, or at which a camera saw nothing, without a single success
/// the calibration is given up.
const HOPELESS_AFTER: u32 = 10;

impl Observations {
    /// Adds the position in line `line` of the file: where the lamp was and what the cameras saw.
    pub(crate) fn add(&mut self, line: usize, lamp: &ReachedPosition, spots: &Spots) {
        self.reached += 1;
        let [x, y, z] = lamp.lamp;
        for (camera, spot) in &spots.seen {
            let table = self.table(camera);
            match spot {
                Some(spot) => {
                    (table.width, table.height) = (spot.width, spot.height);
                    let (u, v) = (spot.u, spot.v);
                    table.points.push(LightPoint { x, y, z, u, v });
                }
                None => {
                    table.missed += 1;
                    let mut reasons = spots.reasons.iter();
                    let own = reasons.find(|(name, _)| name == camera);
                    table.last_miss = own.map_or_else(String::new, |(_, reason)| reason.clone());
                }
            }
        }
        if spots.seen.iter().all(|(_, spot)| spot.is_none()) {
            let reason = spots.why();
            self.unused.push(UnusedPosition { line, reason });
        }
    }

    /// Adds a position that is out of the arm's reach.
    pub(crate) fn skip(&mut self, line: usize, reason: &str) {
        self.out_of_reach += 1;
        self.last_out_of_reach = reason.to_owned();
        let reason = reason.to_owned();
        self.unused.push(UnusedPosition { line, reason });
    }

    fn table(&mut self, camera: &str) -> &mut CameraTable {
        let known = self.cameras.iter().position(|one| one.camera == camera);
        let place = known.unwrap_or(self.cameras.len());
        if known.is_none() {
            self.cameras.push(CameraTable {
                camera: camera.to_owned(),
                ..CameraTable::default()
            });
        }
        // Either found at this place or just pushed there.
        &mut self.cameras[place]
    }

    /// Fails when it is clear, with `left` positions to come, that a camera will not have enough of them,
    /// or that nothing comes of them at all; with the reason that was met most.
    pub(crate) fn hopeful(&self, left: usize) -> Result<(), HandlerError> {
        let left = u32::try_from(left).unwrap_or(u32::MAX);
        if self.reached == 0 && (self.out_of_reach >= HOPELESS_AFTER || left == 0) {
            return Err(HandlerError::new(format!(
                "the arm took none of the first {} positions ({})",
                self.out_of_reach, self.last_out_of_reach
            )));
        }
        for table in &self.cameras {
            let CameraTable { camera, missed, .. } = table;
            let seen = u32::try_from(table.points.len()).unwrap_or(u32::MAX);
            let too_few = seen.saturating_add(left) < self.enough;
            if seen == 0 && *missed > 0 && (*missed >= HOPELESS_AFTER || too_few) {
                return Err(HandlerError::new(format!(
                    "camera `{camera}` has seen no spot at {missed} positions ({}): is the lamp on, and does the camera look at the work volume?",
                    table.last_miss
                )));
            }
            if too_few {
                let (times, what, last) = match *missed >= self.out_of_reach {
                    true => (*missed, "the spot was not seen", &table.last_miss),
                    false => (
                        self.out_of_reach,
                        "the position was out of reach",
                        &self.last_out_of_reach,
                    ),
                };
                return Err(HandlerError::new(format!(
                    "camera `{camera}` has seen the lamp at {seen} positions, {left} are left and {} would be enough; {times} times {what} (the last: {last})",
                    self.enough
                )));
            }
        }
        Ok(())
    }
}

impl Spots {
    /// All reasons in one line.
    pub(crate) fn why(&self) -> String {
        let reasons: Vec<&str> = self.reasons.iter().map(|(_, why)| why.as_str()).collect();
        reasons.join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{objects::Stamp, rig::spot};

    fn lamp() -> ReachedPosition {
        ReachedPosition {
            stamp: Stamp::default(),
            joints: mcs::Joints::zeros(6),
            lamp: [0.1, 0.2, 0.3],
        }
    }

    fn spots(west: bool, east: bool) -> Spots {
        let mut spots = Spots::default();
        for (camera, sees) in [("west", west), ("east", east)] {
            let seen = sees.then(|| spot(camera, 10.0, 20.0));
            spots.seen.push((camera.to_owned(), seen));
            if !sees {
                let reason = format!("camera `{camera}`: too dark");
                spots.reasons.push((camera.to_owned(), reason));
            }
        }
        spots
    }

    #[test]
    fn points_and_misses_of_every_camera_are_the_reached_positions() {
        let mut all = Observations::default();
        all.skip(3, "out of reach");
        for (line, (west, east)) in [(true, true), (true, false), (false, false)]
            .into_iter()
            .enumerate()
        {
            all.add(line + 4, &lamp(), &spots(west, east));
        }
        assert_eq!(all.reached, 3);
        for table in &all.cameras {
            assert_eq!(table.points.len() as u32 + table.missed, all.reached);
        }
        let missed: Vec<u32> = all.cameras.iter().map(|table| table.missed).collect();
        assert_eq!(missed, [1, 2]);
    }

    #[test]
    fn a_position_is_unused_when_the_arm_did_not_arrive_or_no_camera_saw_the_lamp() {
        let mut all = Observations::default();
        all.skip(3, "out of reach");
        all.add(4, &lamp(), &spots(true, false));
        all.add(5, &lamp(), &spots(false, false));
        let unused: Vec<_> = all
            .unused
            .iter()
            .map(|one| (one.line, one.reason.as_str()))
            .collect();
        assert_eq!(
            unused,
            [
                (3, "out of reach"),
                (5, "camera `west`: too dark; camera `east`: too dark")
            ]
        );
    }

    #[test]
    fn a_blind_camera_is_named_after_ten_positions_and_not_before() {
        let mut all = Observations::default();
        let blind = spots(true, false);
        for line in 0..9 {
            all.add(line, &lamp(), &blind);
            assert_eq!(all.hopeful(40), Ok(()));
        }
        all.add(9, &lamp(), &blind);
        let error = all.hopeful(40).unwrap_err().to_string();
        assert!(error.starts_with("camera `east` has seen no spot at 10 positions (camera `east`: too dark): is the lamp on"), "{error}");
    }

    #[test]
    fn a_camera_that_saw_one_spot_is_given_its_chance() {
        let mut all = Observations::default();
        all.add(2, &lamp(), &spots(true, true));
        for line in 3..40 {
            all.add(line, &lamp(), &spots(true, false));
        }
        assert_eq!(all.hopeful(40), Ok(()));
    }

    #[test]
    fn skipped_positions_are_not_laid_to_the_cameras_charge() {
        let mut all = Observations::default();
        all.add(2, &lamp(), &spots(true, false));
        for line in 3..40 {
            all.skip(line, "refused");
        }
        assert_eq!(all.hopeful(40), Ok(()));
    }

    #[test]
    fn an_arm_that_arrives_nowhere_is_given_up_with_its_reason() {
        let mut all = Observations::default();
        for line in 0..10 {
            assert_eq!(all.hopeful(40), Ok(()));
            all.skip(line, "`mcs` is estopped");
        }
        let error = all.hopeful(40).unwrap_err().to_string();
        assert!(
            error.contains("none of the first 10 positions (`mcs` is estopped)"),
            "{error}"
        );
    }
}
