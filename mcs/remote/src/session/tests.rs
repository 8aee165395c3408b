//! Both sides without sockets: what a peer may not do, each with its name, and how it is believed again.

use proptest::prelude::*;

use super::*;
use crate::{
    frame::SIZE,
    peer::{Order, Peer, Refusal},
};

const PERIOD: Duration = Duration::from_micros(4500);
const WATCHDOG: Duration = Duration::from_millis(20);
const START: [f64; 2] = [0.4, -0.2];

/// A driver and a peer with two joints that go where torques push them, in one place.
struct Rig {
    session: Session,
    peer: Peer,
    position: [f64; 2],
    speed: [f64; 2],
    order: Option<Order>,
}

impl Rig {
    fn new() -> Self {
        Self {
            session: Session::new(7, vec![1.0, 2.0], WATCHDOG),
            peer: Peer::new(11, 2),
            position: START,
            speed: [0.0; 2],
            order: None,
        }
    }

    /// A rig whose peer is believed.
    fn met() -> Self {
        let mut rig = Self::new();
        for _ in 0..GOOD {
            rig.round(Power::Off);
        }
        rig.read().unwrap();
        rig
    }

    fn released() -> Self {
        let mut rig = Self::met();
        for _ in 0..3 {
            rig.tick(Power::Released).unwrap();
        }
        assert_eq!(rig.order.as_ref().unwrap().power, Power::Released);
        rig
    }

    fn command(&mut self, power: Power) -> [u8; SIZE] {
        self.session
            .command(&[0.3, -0.1], power, PERIOD, 0)
            .encode()
    }

    /// What the peer answers.
    fn answer(&mut self, command: &[u8]) -> Frame {
        let order = self.peer.take(command).unwrap();
        for joint in 0..2 {
            let released = order.power == Power::Released;
            self.speed[joint] = if released { 0.01 } else { 0.0 };
            self.position[joint] += self.speed[joint] * order.period.as_secs_f64();
        }
        let power = order.power;
        self.order = Some(order);
        let slots = [0, 1].map(|joint| [self.position[joint], self.speed[joint]]);
        self.peer.answer(power, slots, 0)
    }

    fn round(&mut self, power: Power) {
        let command = self.command(power);
        let answer = self.answer(&command).encode();
        self.session.take(&answer);
    }

    fn read(&mut self) -> Result<[SlotReading; 2], Doubt> {
        let mut readings = [SlotReading::default(); 2];
        self.session.read(&mut readings).map(|()| readings)
    }

    /// As a servo does it.
    fn tick(&mut self, power: Power) -> Result<[SlotReading; 2], Doubt> {
        let read = self.read();
        self.round(if read.is_ok() { power } else { Power::Off });
        read
    }

    /// A tick in which the peer answers what `change` makes of its answer.
    fn lie(&mut self, change: impl FnOnce(&mut Frame)) {
        let _ = self.read();
        let command = self.command(Power::Released);
        let mut answer = self.answer(&command);
        change(&mut answer);
        self.session.take(&answer.encode());
    }

    /// The arm is told to brake at once, and after a few good answers all is as before.
    #[track_caller]
    fn stands_and_comes_back(&mut self, doubt: impl FnOnce(&Doubt) -> bool) {
        let found = self.read().unwrap_err();
        assert!(doubt(&found), "{found}");
        assert!(self.session.doubt().is_some());
        for _ in 0..GOOD {
            assert!(self.read().is_err());
            self.round(Power::Released);
            assert_ne!(self.order.as_ref().unwrap().power, Power::Released);
        }
        let readings = self.read().unwrap();
        assert_eq!(readings.map(|reading| reading.position), self.position);
        self.tick(Power::Released).unwrap();
        assert_eq!(self.order.as_ref().unwrap().power, Power::Released);
    }
}

#[test]
fn a_peer_is_believed_after_some_good_answers_and_moves_as_it_is_told() {
    let mut rig = Rig::new();
    assert_eq!(rig.read(), Err(Doubt::NoAnswer));
    for _ in 1..GOOD {
        rig.round(Power::Released);
        assert_eq!(rig.read(), Err(Doubt::NoAnswer));
        assert_eq!(rig.order.as_ref().unwrap().power, Power::Off);
    }
    rig.round(Power::Released);
    let readings = rig.read().unwrap();
    assert_eq!(readings.map(|reading| reading.position), START);
    rig.tick(Power::Released).unwrap();
    let order = rig.order.clone().unwrap();
    assert_eq!(
        (order.power, order.commands),
        (Power::Released, vec![0.3, -0.1])
    );
    assert_eq!(order.period, PERIOD);
    rig.tick(Power::Braked).unwrap();
    let order = rig.order.clone().unwrap();
    assert_eq!((order.power, order.commands), (Power::Braked, vec![0.0; 2]));
}

#[test]
fn a_peer_that_stops_is_silent_after_the_watchdog_and_no_sooner() {
    let mut rig = Rig::released();
    let ticks = (0..100)
        .take_while(|_| {
            let read = rig.read();
            rig.command(Power::Released);
            read.is_ok()
        })
        .count();
    // 20 ms are 4.4 periods; the first reading is of what had come before.
    assert_eq!(ticks, 5);
    rig.stands_and_comes_back(|doubt| matches!(doubt, Doubt::Silent { .. }));
}

#[test]
fn each_lie_of_a_peer_has_a_name_and_leaves_the_arm_standing() {
    type Lie = (fn(&mut Frame), fn(&Doubt) -> bool);
    let lies: [Lie; 14] = [
        (
            |frame| frame.rows_mut()[1].values[0] = f64::NAN,
            |doubt| *doubt == Doubt::NotFinite { slot: 2 },
        ),
        (
            |frame| frame.rows_mut()[0].values[1] = f64::INFINITY,
            |doubt| *doubt == Doubt::NotFinite { slot: 1 },
        ),
        (
            |frame| frame.rows_mut()[0].values[0] += 0.02,
            |doubt| matches!(doubt, Doubt::Jump { slot: 1, .. }),
        ),
        (
            |frame| frame.rows_mut()[1].values[1] = -4.1,
            |doubt| matches!(doubt, Doubt::Speed { slot: 2, .. }),
        ),
        (
            |frame| frame.sequence = 2,
            |doubt| matches!(doubt, Doubt::Old { found: 2, .. }),
        ),
        (
            |frame| frame.sequence -= 1,
            |doubt| matches!(doubt, Doubt::Old { .. }),
        ),
        (
            |frame| frame.answers -= 1,
            |doubt| matches!(doubt, Doubt::Answer { .. }),
        ),
        (
            |frame| frame.answers += 1,
            |doubt| matches!(doubt, Doubt::Answer { .. }),
        ),
        (
            |frame| {
                let before = *frame;
                *frame = Frame::new(Kind::State, 3);
                (frame.session, frame.receiver) = (before.session, before.receiver);
                (frame.sequence, frame.answers) = (before.sequence, before.answers);
            },
            |doubt| {
                matches!(
                    doubt,
                    Doubt::Slots {
                        found: 3,
                        needed: 2
                    }
                )
            },
        ),
        (
            |frame| frame.kind = Kind::Command,
            |doubt| *doubt == Doubt::Kind,
        ),
        (
            |frame| frame.receiver += 1,
            |doubt| *doubt == Doubt::Receiver,
        ),
        (
            |frame| frame.power = Power::Off,
            |doubt| *doubt == Doubt::Power,
        ),
        (
            |frame| frame.power = Power::Braked,
            |doubt| *doubt == Doubt::Power,
        ),
        (
            |frame| frame.trouble = Trouble::Refused,
            |doubt| *doubt == Doubt::Own(Trouble::Refused),
        ),
    ];
    for (lie, doubt) in lies {
        let mut rig = Rig::released();
        rig.lie(lie);
        rig.stands_and_comes_back(doubt);
    }
}

#[test]
fn bytes_that_are_no_frame_are_doubted_and_each_says_why() {
    for (at, error) in [
        (0, FrameError::Magic),
        (4, FrameError::Version { found: 0xfe }),
        (300, FrameError::Checksum),
        (603, FrameError::Checksum),
    ] {
        let mut rig = Rig::released();
        rig.read().unwrap();
        let command = rig.command(Power::Released);
        let mut answer = rig.answer(&command).encode();
        answer[at] ^= 0xff;
        rig.session.take(&answer);
        rig.stands_and_comes_back(|doubt| *doubt == Doubt::Frame(error));
    }
}

#[test]
fn an_answer_that_comes_twice_is_doubted() {
    let mut rig = Rig::released();
    rig.read().unwrap();
    let command = rig.command(Power::Released);
    let answer = rig.answer(&command).encode();
    rig.session.take(&answer);
    rig.session.take(&answer);
    rig.stands_and_comes_back(|doubt| matches!(doubt, Doubt::Old { .. }));
}

#[test]
fn a_peer_that_is_started_again_has_to_be_believed_again_and_does_not_move_before() {
    let mut rig = Rig::released();
    rig.peer = Peer::new(12, 2);
    rig.position = [1.5, -1.5];
    rig.tick(Power::Released).unwrap();
    // What was meant for the one before is not obeyed.
    assert_eq!(rig.order.as_ref().unwrap().power, Power::Braked);
    rig.stands_and_comes_back(|doubt| *doubt == Doubt::BeganAgain);
}

#[test]
fn a_driver_that_is_started_again_is_obeyed_once_it_knows_its_peer() {
    let mut rig = Rig::released();
    rig.session = Session::new(8, vec![1.0, 2.0], WATCHDOG);
    for _ in 0..GOOD {
        rig.round(Power::Released);
        assert_eq!(rig.order.as_ref().unwrap().power, Power::Off);
    }
    rig.tick(Power::Released).unwrap();
    assert_eq!(rig.order.as_ref().unwrap().power, Power::Released);
}

#[test]
fn a_peer_that_goes_on_when_it_was_told_to_brake_is_named() {
    let mut rig = Rig::released();
    let mut found = None;
    for _ in 0..20 {
        if let Err(doubt) = rig.read() {
            found.get_or_insert(doubt);
            break;
        }
        let command = rig.command(Power::Braked);
        let mut answer = rig.answer(&command);
        answer.power = Power::Released;
        rig.session.take(&answer.encode());
    }
    assert!(matches!(found, Some(Doubt::Disobeys { .. })), "{found:?}");
}

#[test]
fn a_peer_that_answers_long_after_is_late() {
    let mut rig = Rig::released();
    let mut behind = std::collections::VecDeque::new();
    let found = (0..50).find_map(|tick| {
        let read = rig.read().err();
        let command = rig.command(Power::Released);
        behind.push_back(command);
        // One command in two is answered: it falls behind, and is never silent.
        if tick % 2 == 0 {
            let command = behind.pop_front().unwrap();
            let answer = rig.answer(&command).encode();
            rig.session.take(&answer);
        }
        read
    });
    assert!(matches!(found, Some(Doubt::Stale { .. })), "{found:?}");
}

#[test]
fn lost_frames_are_no_lie_while_others_come() {
    let mut rig = Rig::released();
    for tick in 0..200 {
        rig.read().unwrap();
        let command = rig.command(Power::Released);
        match tick % 5 {
            // The command is lost, or the answer is.
            0 => {}
            1 => drop(rig.answer(&command)),
            _ => {
                let answer = rig.answer(&command).encode();
                rig.session.take(&answer);
            }
        }
    }
}

#[test]
fn a_peer_brakes_when_commands_stop_and_until_one_does_not_release() {
    let mut rig = Rig::released();
    assert_eq!(rig.peer.watchdog(), Some(WATCHDOG));
    rig.peer.silent();
    let command = rig.command(Power::Released);
    let answer = rig.answer(&command);
    assert_eq!(
        (answer.power, answer.trouble),
        (Power::Braked, Trouble::Late)
    );
    rig.session.take(&answer.encode());
    rig.stands_and_comes_back(|doubt| *doubt == Doubt::Own(Trouble::Late));
}

#[test]
fn a_peer_refuses_what_it_cannot_do_and_does_not_answer_what_is_old() {
    let mut rig = Rig::released();
    let command = rig.command(Power::Released);
    rig.answer(&command);
    assert_eq!(rig.peer.take(&command), Err(Refusal::Old));
    let mut frame = Frame::decode(&rig.command(Power::Released)).unwrap();
    frame.rows_mut()[0].mode = Mode::Velocity;
    let answer = rig.answer(&frame.encode());
    assert_eq!(
        (answer.power, answer.trouble),
        (Power::Braked, Trouble::Refused)
    );
    let mut frame = Frame::decode(&rig.command(Power::Released)).unwrap();
    frame.rows_mut()[0].values[0] = f64::NAN;
    assert_eq!(rig.answer(&frame.encode()).trouble, Trouble::Refused);
    let three = Frame::new(Kind::Command, 3).encode();
    let refused = rig.peer.take(&three).unwrap_err();
    assert_eq!(
        refused,
        Refusal::Slots {
            found: 3,
            needed: 2
        }
    );
    let state = Frame::new(Kind::State, 2).encode();
    assert_eq!(rig.peer.take(&state), Err(Refusal::Kind));
    assert!(rig.peer.take(&[]).is_err());
}

proptest! {
    /// A peer that now and then says anything at all: what is read is finite, within what a joint can do since the reading
    /// before, and nobody is told to move by a driver that does not believe its peer.
    #[test]
    fn whatever_a_peer_says_readings_stay_possible(lies in proptest::collection::vec((0..12_u8, -1e3..1e3_f64), 1..200)) {
        let mut rig = Rig::met();
        let mut before: Option<[SlotReading; 2]> = None;
        for (lie, value) in lies {
            let read = rig.read();
            let believed = read.is_ok();
            if let (Ok(readings), Some(before)) = (&read, before) {
                for (joint, most) in [1.0, 2.0].into_iter().enumerate() {
                    prop_assert!(readings[joint].velocity.abs() <= FACTOR * most);
                    let by = readings[joint].position - before[joint].position;
                    prop_assert!(by.abs() <= FACTOR * most * PERIOD.as_secs_f64() + COUNTS);
                }
            }
            before = read.ok();
            let command = rig.command(Power::Released);
            let sent = Frame::decode(&command).unwrap();
            prop_assert_eq!(sent.power == Power::Released, believed);
            let mut answer = rig.answer(&command);
            match lie {
                0 => answer.rows_mut()[0].values[0] += value,
                1 => answer.rows_mut()[1].values[1] = value,
                2 => answer.sequence = value as u64,
                3 => answer.answers = value as u64,
                4 => answer.session = value as u32,
                5 => answer.rows_mut()[0].values[0] = 1.0 / (value - value),
                _ => {}
            }
            rig.session.take(&answer.encode());
        }
    }
}
