//! The simulated arm as six slots behind the channel driver of the testbed interface.

use std::{f64::consts::TAU, time::Duration};

use mcs::driver::{ChannelDriver, DriverError, Power, SlotReading};

use crate::{
    cell::Cell,
    puma560::JOINTS,
    scene::{self, SceneReader, SceneState, SceneWriter},
    world::{World, WorldError},
};

/// Encoder counts per turn of a joint: a resolution of 9.6e-5 rad. The choice is ours; no figure for
/// the original encoders could be found.
pub const COUNTS_PER_TURN: f64 = 65_536.0;

/// Channel driver of the simulated PUMA 560.
///
/// Positions are read back with the encoder's resolution; velocities are those of an ideal tachometer.
/// [`write`](ChannelDriver::write) advances the world by the period. Nothing here allocates, locks or
/// waits, except that the physics engine allocates small matrices in each of its steps.
#[derive(Debug)]
pub struct SimArm {
    name: String,
    world: World,
    lamp_offset: nalgebra::Point3<f64>,
    lamp_on: bool,
    scene: SceneWriter,
}

impl SimArm {
    /// The arm of `cell`, called `name` in errors, and where its scene can be read.
    ///
    /// # Errors
    /// When the physics cannot be built.
    pub fn new(name: impl Into<String>, cell: &Cell) -> Result<(Self, SceneReader), WorldError> {
        let world = World::new(&cell.world())?;
        let first = cell.scene(&cell.start);
        let (writer, reader) = scene::channel(first);
        let arm = Self {
            name: name.into(),
            world,
            lamp_offset: cell.lamp.offset,
            lamp_on: cell.lamp.on,
            scene: writer,
        };
        Ok((arm, reader))
    }

    fn fault(&self, reason: impl ToString) -> DriverError {
        DriverError::Fault {
            driver: self.name.clone(),
            reason: reason.to_string(),
        }
    }

    fn count(&self, what: &str, given: usize) -> DriverError {
        self.fault(format!("was given {given} {what} for {JOINTS} slots"))
    }

    fn publish(&mut self) {
        let links = self.world.link_poses();
        let [.., wrist] = &links;
        let lamp = wrist * self.lamp_offset;
        self.scene.write(SceneState {
            stamp: self.world.elapsed(),
            links,
            lamp,
            lamp_on: self.lamp_on,
        });
    }
}

/// The nearest angle that the encoder can show, rad.
fn encoder(angle: f64) -> f64 {
    (angle / TAU * COUNTS_PER_TURN).round() / COUNTS_PER_TURN * TAU
}

impl ChannelDriver for SimArm {
    fn slots(&self) -> usize {
        JOINTS
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        if readings.len() != JOINTS {
            return Err(self.count("readings", readings.len()));
        }
        let state = self.world.positions().iter().zip(self.world.velocities());
        for (reading, (position, velocity)) in readings.iter_mut().zip(state) {
            *reading = SlotReading {
                position: encoder(*position),
                velocity: *velocity,
            };
        }
        Ok(())
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        let torques: &[f64; JOINTS] = torques
            .try_into()
            .map_err(|_| self.count("torques", torques.len()))?;
        match power {
            Power::Released => self.world.drive(torques, period),
            Power::Off | Power::Braked => self.world.brake(period),
        }
        .map_err(|error| self.fault(error))?;
        self.publish();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;

    use super::*;

    const PERIOD: Duration = Duration::from_micros(4500);

    fn arm() -> (SimArm, SceneReader, Cell) {
        let text = include_str!("../../configs/cell.toml");
        let cell = Cell::parse(&Source::new("cell.toml", text)).unwrap();
        let (arm, reader) = SimArm::new("puma", &cell).unwrap();
        (arm, reader, cell)
    }

    #[test]
    fn positions_are_read_back_to_the_nearest_encoder_count() {
        let (mut arm, _, cell) = arm();
        let mut readings = [SlotReading::default(); 6];
        arm.read(&mut readings).unwrap();
        for (reading, start) in readings.iter().zip(cell.start) {
            assert!((reading.position - start).abs() <= 0.5 * TAU / COUNTS_PER_TURN);
            let counts = reading.position / TAU * COUNTS_PER_TURN;
            assert!((counts - counts.round()).abs() < 1e-6);
        }
    }

    #[test]
    fn only_released_brakes_let_torques_move_the_arm() {
        let (mut arm, reader, _) = arm();
        let start = *arm.world.positions();
        for power in [Power::Off, Power::Braked] {
            for _ in 0..20 {
                arm.write(&[90.0, 0.0, 0.0, 0.0, 0.0, 0.0], power, PERIOD)
                    .unwrap();
            }
            assert_eq!(*arm.world.positions(), start);
        }
        let before = reader.latest();
        for _ in 0..20 {
            arm.write(&[90.0, 0.0, 0.0, 0.0, 0.0, 0.0], Power::Released, PERIOD)
                .unwrap();
        }
        assert!(arm.world.positions()[0] > start[0] + 0.01);
        let after = reader.latest();
        assert!((after.lamp - before.lamp).norm() > 1e-3);
        assert_eq!(after.stamp, 60 * PERIOD);
    }

    #[test]
    fn the_scene_shows_the_lamp_where_the_kinematics_put_it() {
        let (mut arm, reader, cell) = arm();
        for _ in 0..30 {
            arm.write(&[20.0, 0.0, 5.0, 1.0, 1.0, 1.0], Power::Released, PERIOD)
                .unwrap();
        }
        let expected = cell.scene(arm.world.positions());
        assert!((reader.latest().lamp - expected.lamp).norm() < 1e-6);
    }

    #[test]
    fn a_torque_that_is_no_number_or_a_wrong_count_is_a_fault_that_names_the_driver() {
        let (mut arm, ..) = arm();
        let error = arm
            .write(&[f64::NAN; 6], Power::Released, PERIOD)
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "channel driver `puma`: the torque of joint 1 is NaN, not a finite number"
        );
        let error = arm.write(&[0.0; 5], Power::Released, PERIOD).unwrap_err();
        assert!(error.to_string().contains("5 torques for 6 slots"));
        assert!(arm.read(&mut []).is_err());
    }
}
