//! A servo and the simulated world in two threads, over real sockets. The servo ticks when an answer has come, so that no
//! test depends on how fast the machine is.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot be set up fails"
)]

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{JoinHandle, spawn},
    time::Duration,
};

use ctos::{diagnostic::Source, time::Clock};
use mcs::{
    Joints,
    control::PidGravity,
    driver::{ChannelDriver, DriverError, Power, SlotReading},
    model::{Model, built_in, file::Inertias},
    servo::{Fault, MotionPhase, Servo, ServoCommand, ServoConfig, ServoPort},
    trajectory::{CartesianLimits, Planner},
};
use mcs_remote::{
    driver::RemoteArm,
    session::Session,
    socket::{Address, Line, PeerSocket},
};
use sim::{cell::Cell, driver::SimArm, port::Port, served::Served, simulation::Simulation};

const WATCHDOG: Duration = Duration::from_millis(100);
const BY: [f64; 6] = [0.4, -0.3, 0.2, 0.5, -0.3, 0.6];

fn cell() -> Cell {
    let text = include_str!("../../configs/cell.toml");
    Cell::parse(&Source::new("cell.toml", text)).unwrap()
}

fn model() -> Arc<Model> {
    Arc::new(
        built_in::model("puma560", Inertias::Engine)
            .unwrap()
            .unwrap(),
    )
}

/// A world that answers at an address until it is dropped.
struct Running {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<Served>>,
}

impl Running {
    fn start(socket: PeerSocket, mut served: Served) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&over);
        let thread = Some(spawn(move || {
            served.serve(&socket, &until).unwrap();
            served
        }));
        Self { over, thread }
    }

    fn end(mut self) -> Served {
        self.over.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

fn served(own: u32) -> Served {
    Served::new(&cell(), 0, own).unwrap()
}

/// A peer at a free port, or at a path, and its address.
fn somewhere(folder: Option<&Path>) -> (PeerSocket, Address) {
    match folder {
        Some(folder) => {
            let address = Address::Unix(folder.join("arm.socket"));
            (PeerSocket::bind(&address).unwrap(), address)
        }
        None => {
            let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
            let port = socket.local_addr().unwrap().port();
            let host = "127.0.0.1".to_owned();
            (PeerSocket::Udp(socket), Address::Udp { host, port })
        }
    }
}

/// A driver that has its peer's answer before it is read, or gives it up.
struct InStep(RemoteArm, Duration);

impl ChannelDriver for InStep {
    fn slots(&self) -> usize {
        self.0.slots()
    }

    fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
        if self.0.unanswered() > 0 {
            self.0.wait(self.1);
        }
        self.0.read(readings)
    }

    fn write(
        &mut self,
        torques: &[f64],
        power: Power,
        period: Duration,
    ) -> Result<(), DriverError> {
        self.0.write(torques, power, period)
    }
}

fn remote(address: &Address, patience: Duration) -> RemoteArm {
    let speeds = model()
        .joints()
        .iter()
        .map(|joint| joint.limits.velocity)
        .collect();
    let session = Session::new(5, speeds, WATCHDOG);
    let line = Line::open(address).unwrap();
    let mut arm = RemoteArm::new("servo", (address.clone(), line), session, Clock::real());
    let _ = arm.meet(ServoConfig::default().period, patience);
    arm
}

fn servo(driver: impl ChannelDriver + 'static) -> (Servo, ServoPort) {
    let law = PidGravity::new(model(), 8.0, 1.0);
    Servo::new(
        model(),
        Box::new(driver),
        Box::new(law),
        ServoConfig::default(),
    )
    .unwrap()
}

/// Ticks until the servo shows what is wanted.
#[track_caller]
fn until(servo: &mut Servo, what: impl Fn(&mcs::servo::ServoStatus) -> bool) {
    for _ in 0..3000 {
        servo.tick(0);
        if what(servo.status()) {
            return;
        }
    }
    panic!("{:?}", servo.status());
}

/// Lets go of the brakes and moves on, and back to the brakes; the largest distance from the setpoints.
#[track_caller]
fn moves(servo: &mut Servo, port: &ServoPort, id: u64) -> f64 {
    port.order(ServoCommand::PowerOn).unwrap();
    port.order(ServoCommand::ReleaseBrakes).unwrap();
    until(servo, |status| status.power == Power::Released);
    let start = servo.status().setpoint;
    let goal = Joints::from_fn(6, |joint| start[joint] + BY[joint]);
    let planner = Planner::new(model(), CartesianLimits::default(), 0.018).unwrap();
    let segment = planner.joint(&start, &goal, 1.0).unwrap();
    port.order(ServoCommand::Move { id, segment }).unwrap();
    until(servo, |status| {
        status.motion.id == id && status.motion.phase.is_over()
    });
    assert_eq!(servo.status().motion.phase, MotionPhase::Done);
    servo.status().motion.max_tracking_error.turning
}

#[test]
fn a_motion_over_the_wire_is_that_of_the_world_itself_to_the_bit() {
    let (cell, folder) = (cell(), tempfile::tempdir().unwrap());
    /// The world of this process, which goes on with each write.
    struct Near(SimArm, Simulation);
    impl ChannelDriver for Near {
        fn slots(&self) -> usize {
            self.0.slots()
        }

        fn read(&mut self, readings: &mut [SlotReading]) -> Result<(), DriverError> {
            self.0.read(readings)
        }

        fn write(
            &mut self,
            torques: &[f64],
            power: Power,
            period: Duration,
        ) -> Result<(), DriverError> {
            self.0.write(torques, power, period)?;
            self.1.tick(period, 0, Duration::ZERO).unwrap();
            Ok(())
        }
    }
    let port = Arc::new(Port::new(&cell));
    let world = Simulation::new(&cell, Arc::clone(&port));
    let arm = SimArm::new("servo", ("world", &port, &cell), 0, &[0, 1, 2, 3, 4, 5]).unwrap();
    let (mut near, near_port) = servo(Near(arm, world));
    let expected = moves(&mut near, &near_port, 1);
    for folder in [None, Some(folder.path())] {
        let (socket, address) = somewhere(folder);
        let _running = Running::start(socket, served(1));
        let arm = remote(&address, Duration::from_secs(10));
        let (mut far, port) = servo(InStep(arm, Duration::from_secs(10)));
        assert_eq!(moves(&mut far, &port, 1).to_bits(), expected.to_bits());
        assert_eq!(far.status().position, near.status().position);
        assert_eq!(far.status().torque, near.status().torque);
    }
}

#[test]
fn a_peer_that_dies_leaves_a_standing_arm_and_works_again_when_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    for folder in [None, Some(folder.path())] {
        let (socket, address) = somewhere(folder);
        let running = Running::start(socket, served(1));
        let arm = remote(&address, Duration::from_secs(10));
        let (mut servo, port) = servo(InStep(arm, Duration::from_millis(20)));
        moves(&mut servo, &port, 1);
        running.end();
        until(&mut servo, |status| status.fault.is_some());
        assert_eq!(servo.status().fault, Some(Fault::Driver));
        assert_eq!(servo.status().power, Power::Off);
        let said = port.driver_error().unwrap().to_string();
        assert!(said.contains(&format!("the peer at `{address}`")), "{said}");
        assert!(
            said.contains("silent") || said.contains("cannot be reached"),
            "{said}"
        );
        // A reset alone does not bring it back.
        port.order(ServoCommand::Reset).unwrap();
        servo.tick(0);
        assert_eq!(servo.status().fault, Some(Fault::Driver));
        let socket = PeerSocket::bind(&address).unwrap();
        let _running = Running::start(socket, served(2));
        until(&mut servo, |status| {
            port.order(ServoCommand::Reset).unwrap();
            status.fault.is_none()
        });
        moves(&mut servo, &port, 2);
    }
}

#[test]
fn a_world_whose_driver_falls_silent_brakes() {
    let (socket, address) = somewhere(None);
    let running = Running::start(socket, served(1));
    let arm = remote(&address, Duration::from_secs(10));
    let (mut servo, port) = servo(InStep(arm, Duration::from_secs(10)));
    port.order(ServoCommand::PowerOn).unwrap();
    port.order(ServoCommand::ReleaseBrakes).unwrap();
    until(&mut servo, |status| status.power == Power::Released);
    let start = servo.status().setpoint;
    let goal = Joints::from_fn(6, |joint| start[joint] + BY[joint]);
    let planner = Planner::new(model(), CartesianLimits::default(), 0.018).unwrap();
    let segment = planner.joint(&start, &goal, 1.0).unwrap();
    port.order(ServoCommand::Move { id: 1, segment }).unwrap();
    until(&mut servo, |status| status.velocity[0] > 0.2);
    // The servo ticks no more, but is not gone: nothing told the world to brake.
    let clock = Clock::real();
    let end = clock.now() + WATCHDOG * 3;
    while clock.now() < end {
        std::thread::yield_now();
    }
    let served = running.end();
    assert!(served.stands());
    assert!(served.positions()[0] < goal[0] - 0.05);
    drop(servo);
}

#[test]
fn a_driver_whose_peer_never_was_there_says_so_and_meets_it_later() {
    let folder = tempfile::tempdir().unwrap();
    let address = Address::Unix(folder.path().join("arm.socket"));
    let arm = remote(&address, Duration::from_secs(10));
    let (mut servo, port) = servo(InStep(arm, Duration::from_millis(20)));
    servo.tick(0);
    assert_eq!(servo.status().fault, Some(Fault::Driver));
    let said = port.driver_error().unwrap().to_string();
    assert!(
        said.contains("cannot be reached: entity not found"),
        "{said}"
    );
    let _running = Running::start(PeerSocket::bind(&address).unwrap(), served(1));
    until(&mut servo, |status| {
        port.order(ServoCommand::Reset).unwrap();
        status.fault.is_none()
    });
    moves(&mut servo, &port, 1);
}

#[test]
fn a_tick_over_the_wire_allocates_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for folder in [None, Some(folder.path())] {
        let (socket, address) = somewhere(folder);
        let _running = Running::start(socket, served(1));
        let arm = remote(&address, Duration::from_secs(10));
        let (mut servo, port) = servo(InStep(arm, Duration::from_secs(10)));
        port.order(ServoCommand::PowerOn).unwrap();
        port.order(ServoCommand::ReleaseBrakes).unwrap();
        let ticks = || (0..100).for_each(|_| servo.tick(0));
        assert_eq!(allocation_counter::measure(ticks).count_total, 0);
        assert_eq!(servo.status().power, Power::Released);
    }
}
