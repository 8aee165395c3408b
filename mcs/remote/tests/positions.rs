//! A controller that takes only positions, or speeds, behind the protocol: the same planner, servo and laws drive it.

#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::{sync::Arc, time::Duration};

use mcs::{
    Joints,
    control::PidGravity,
    driver::{ChannelDriver, DriverError, Mode, Power, SlotReading},
    model::{Model, built_in, file::Inertias},
    servo::{MotionPhase, Servo, ServoCommand, ServoConfig, ServoPort},
    trajectory::{CartesianLimits, Planner},
};
use mcs_remote::{frame::Frame, peer::Peer, session::Session};

const START: [f64; 6] = [0.1, 0.8, -2.6, 0.2, 0.7, 0.1];
const GOAL: [f64; 6] = [-0.6, 1.4, -2.9, -0.4, 0.2, 1.1];

fn model() -> Arc<Model> {
    let model = built_in::model("puma560", Inertias::Engine);
    Arc::new(model.unwrap().unwrap())
}

/// Both sides of the protocol, and joints that are where, or as fast as, a command says when the next one is due.
struct Exact {
    session: Session,
    peer: Peer,
    takes: Mode,
    q: [f64; 6],
    qd: [f64; 6],
}

impl Exact {
    fn new(orders: Mode, takes: Mode) -> Self {
        let limits = model();
        let speeds = limits.joints().iter().map(|joint| joint.limits.velocity);
        let session = Session::new(7, speeds.collect(), Duration::from_millis(100));
        let mut exact = Self {
            session: session.commanding(&[orders; 6]),
            peer: Peer::new(11, 6).taking(&[takes; 6]),
            takes,
            q: START,
            qd: [0.0; 6],
        };
        for _ in 0..4 {
            exact
                .write(&[0.0; 6], Power::Off, Duration::from_millis(4))
                .unwrap();
        }
        exact
    }
}

impl ChannelDriver for Exact {
    fn slots(&self) -> usize {
        6
    }

    fn modes(&self) -> &[Mode] {
        self.session.modes()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        let read = self.session.read(readings);
        read.map_err(|doubt| DriverError::Fault {
            driver: "exact".to_owned(),
            reason: format!("the peer {doubt}"),
        })
    }

    fn write(
        &mut self,
        commands: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        let bytes = self.session.command(commands, power, period, 0).encode();
        let order = self.peer.take(&bytes).unwrap();
        let seconds = period.as_secs_f64();
        for (joint, command) in order.commands.iter().enumerate() {
            let (before, speed) = (self.q[joint], self.qd[joint]);
            (self.q[joint], self.qd[joint]) = match (order.power, self.takes) {
                (Power::Released, Mode::Position) => (*command, (command - before) / seconds),
                (Power::Released, Mode::Velocity) => {
                    (before + 0.5 * (speed + command) * seconds, *command)
                }
                _ => (before, 0.0),
            };
        }
        let slots = self.q.iter().zip(&self.qd).map(|(q, qd)| [*q, *qd]);
        let answer: Frame = self.peer.answer(order.power, slots, 0);
        self.session.take(&answer.encode());
        Ok(())
    }
}

fn servo(driver: Exact) -> (Servo, ServoPort) {
    let law = PidGravity::new(model(), 8.0, 1.0);
    let config = ServoConfig::default();
    Servo::new(model(), Box::new(driver), Box::new(law), config).unwrap()
}

fn ticks(servo: &mut Servo, most: u32, until: impl Fn(&Servo) -> bool) {
    for _ in 0..most {
        servo.tick(0);
        if until(servo) {
            return;
        }
    }
}

#[test]
fn a_controller_of_positions_or_speeds_is_driven_through_whole_motions_and_stops() {
    let limits = model();
    let hardest = limits
        .joints()
        .iter()
        .map(|joint| joint.limits.acceleration);
    let hardest = hardest.fold(0.0, f64::max);
    // An acceleration that turns round within a period is known as its mean only. Of speeds these errors add up until the
    // servo takes them back.
    let one = hardest * ServoConfig::default().period.as_secs_f64().powi(2) / 4.0;
    for (mode, exactly) in [(Mode::Position, one), (Mode::Velocity, 4.0 * one)] {
        let (mut servo, port) = servo(Exact::new(mode, mode));
        port.order(ServoCommand::PowerOn).unwrap();
        port.order(ServoCommand::ReleaseBrakes).unwrap();
        servo.tick(0);
        assert_eq!(
            servo.status().power,
            Power::Released,
            "{:?}",
            port.driver_error()
        );
        let planner = Planner::new(model(), CartesianLimits::default(), 0.018).unwrap();
        let segment = planner.joint(&START.into(), &GOAL.into(), 1.0).unwrap();
        port.order(ServoCommand::Move { id: 1, segment }).unwrap();
        ticks(&mut servo, 3000, |servo| {
            servo.status().ended.of(1).is_some()
        });
        let motion = servo.status().motion;
        assert_eq!(motion.phase, MotionPhase::Done, "{:?}", port.driver_error());
        // It is told where to be when the next command is due, and is there.
        assert!(
            motion.max_tracking_error.turning < exactly,
            "{mode:?}: {motion:?}"
        );
        assert!(motion.error.turning < 1e-4, "{mode:?}: {motion:?}");
        assert_eq!(servo.status().torque, [0.0; 6]);
        let back = planner.joint(&GOAL.into(), &START.into(), 1.0).unwrap();
        let from = servo.status().setpoint;
        assert_eq!(from, Joints::from(GOAL));
        port.order(ServoCommand::Move {
            id: 2,
            segment: back,
        })
        .unwrap();
        ticks(&mut servo, 80, |_| false);
        port.order(ServoCommand::ControlledStop).unwrap();
        ticks(&mut servo, 1000, |servo| servo.status().power == Power::Off);
        let status = servo.status();
        assert_eq!(
            (status.power, status.motion.phase),
            (Power::Off, MotionPhase::Stopped)
        );
        assert!(status.velocity.iter().all(|speed| speed.abs() < 5e-3));
    }
}

#[test]
fn a_peer_that_takes_only_positions_refuses_torques_by_name_and_does_not_move() {
    for (orders, takes) in [
        (Mode::Torque, Mode::Position),
        (Mode::Velocity, Mode::Position),
        (Mode::Position, Mode::Torque),
    ] {
        let (mut servo, port) = servo(Exact::new(orders, takes));
        port.order(ServoCommand::PowerOn).unwrap();
        port.order(ServoCommand::ReleaseBrakes).unwrap();
        ticks(&mut servo, 5, |servo| servo.status().fault.is_some());
        let said = port.driver_error().unwrap().to_string();
        assert!(said.contains("it cannot do what a command said"), "{said}");
        assert_eq!(servo.status().power, Power::Off);
        assert_eq!(servo.status().position, START);
    }
}
