//! What the hand does at something that pushes back: it presses no more than a little, and comes back to it slowly (SORMA technical
//! report, section 2.2.1: a virtual spring at the target that the environment counterbalances). Knows no tasks.
//!
//! A force says where a surface is and which way it faces. Towards it the speed is what is left of the force that is held, by a
//! resistance: `v = (F_held - F) / R`. From there to the most that is pressed it stands, and beyond that it goes back likewise.
//! So force follows from speed by one integration, which is steady for every stiffness up to about `R` over the delay of the loop.
//! Along the surface and away from it the hand goes as the spring wants.

use nalgebra::{Point3, Vector3};
use serde::Deserialize;

/// Less than this part of what a contact needs is none, and a surface that gives way by this, m, is not there any more.
const NOTHING: f64 = 0.3;
const GONE: f64 = 0.01;

/// How the hand meets something.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ContactArgs {
    /// More than this is a contact, N.
    pub touch_n: f64,
    /// What the hand presses with when its goal is behind the surface, N.
    pub held_n: f64,
    /// Beyond this the hand goes away from the surface, N: a servo that integrates would press more and more else.
    pub most_n: f64,
    /// Force for each speed towards the surface, N s/m.
    pub resistance: f64,
    /// So far before a surface that was touched the hand is slow already, m.
    pub near_m: f64,
}

impl Default for ContactArgs {
    fn default() -> Self {
        Self {
            touch_n: 3.0,
            held_n: 4.0,
            most_n: 10.0,
            resistance: 800.0,
            near_m: 0.03,
        }
    }
}

impl ContactArgs {
    /// The first number that cannot be, by its key.
    #[must_use]
    pub fn wrong(&self) -> Option<(&'static str, f64)> {
        let all = [
            ("touch_n", self.touch_n),
            ("held_n", self.held_n),
            ("most_n", self.most_n),
            ("resistance", self.resistance),
            ("near_m", self.near_m),
        ];
        let wrong = |(_, value): &(_, f64)| !(*value > 0.0 && *value <= 1e6);
        all.into_iter().find(wrong)
    }
}

/// What was touched last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    args: ContactArgs,
    /// Where the hand was sent then, m, and the direction away from the surface.
    surface: Option<(Point3<f64>, Vector3<f64>)>,
}

impl Contact {
    /// Of a hand that has touched nothing.
    #[must_use]
    pub fn new(args: ContactArgs) -> Self {
        Self {
            args,
            surface: None,
        }
    }

    /// How fast a hand may go that wants to go so, m/s, feels this force, N, and is sent to `place`, m. A force with a number that is
    /// none counts as nothing.
    pub fn allow(
        &mut self,
        force: &Vector3<f64>,
        place: &Point3<f64>,
        wanted: Vector3<f64>,
    ) -> Vector3<f64> {
        let finite = force.iter().all(|number| number.is_finite());
        let force = if finite { *force } else { Vector3::zeros() };
        let felt = force.norm();
        if felt > self.args.touch_n {
            self.surface = Some((*place, force / felt));
        }
        let Some((there, away)) = self.surface else {
            return wanted;
        };
        let off = (place - there).dot(&away);
        let is_gone = off < -GONE && felt < NOTHING * self.args.touch_n;
        if is_gone || off > self.args.near_m {
            self.surface = None;
            return wanted;
        }
        let pressed = force.dot(&away);
        let left = (self.args.held_n - pressed).max(0.0) - (pressed - self.args.most_n).max(0.0);
        let most = left / self.args.resistance;
        let inward = -wanted.dot(&away);
        wanted + away * (inward - most).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::control::{Control, ControlArgs};

    const PERIOD: f64 = 0.0045;

    /// The forces that the sensor reads, N. The arm has 8 kg at its hand; its servo of 8 Hz follows three periods late. A wall stands
    /// at x = 0, with a stiffness in N/m. The ball goes into it with a speed, m/s, by a depth, m.
    fn pressed(stiffness: f64, speed: f64, depth: f64) -> Vec<f64> {
        let (mass, natural, sensor) = (8.0, TAU * 8.0, TAU * 30.0);
        let mut control = Control::new(ControlArgs::default(), Point3::new(-0.05, 0.0, 0.0));
        let mut sent = vec![-0.05; 3];
        let (mut hand, mut fast, mut felt) = (-0.05_f64, 0.0_f64, 0.0);
        let mut forces = Vec::new();
        for tick in 1..4000 {
            let now = f64::from(tick) * PERIOD;
            if tick % 9 == 0 {
                let seen = now - 0.04;
                let ball = (-0.05 + speed * (seen - 1.0).max(0.0)).min(depth);
                control.measure(now, seen, &Point3::new(ball, 0.0, 0.0));
            }
            let ratio = control.go(
                now,
                &Vector3::new(-felt, 0.0, 0.0),
                &Vector3::zeros(),
                PERIOD,
            );
            assert!(ratio <= 1.0 + 1e-9);
            sent.push(control.course().place.x);
            let to = sent[sent.len() - 4];
            let mut force = 0.0;
            for _ in 0..9 {
                force = match hand > 0.0 {
                    true => (stiffness * hand + 20.0 * fast).max(0.0),
                    false => 0.0,
                };
                let servo = natural * natural * (to - hand) - 2.0 * natural * fast;
                fast += (servo - force / mass) * PERIOD / 9.0;
                hand += fast * PERIOD / 9.0;
            }
            felt += (force - felt) * (1.0 - (-sensor * PERIOD).exp());
            forces.push(felt);
        }
        forces
    }

    #[test]
    fn a_wall_in_the_way_is_pressed_with_less_than_15_n_and_without_oscillation() {
        let walls = [(1e3, 0.15), (3e3, 0.06), (10e3, 0.02), (30e3, 0.007)];
        for (stiffness, speed) in walls {
            for depth in [0.01, 0.1] {
                let forces = pressed(stiffness, speed, depth);
                let most = forces.iter().copied().fold(0.0, f64::max);
                let told = format!("{stiffness} N/m at {speed} m/s, {depth} m deep");
                assert!(most < 15.0, "{told}: {most} N");
                let end = &forces[forces.len() - 400..];
                let (low, high) = end.iter().fold((f64::MAX, 0.0_f64), |(low, high), force| {
                    (low.min(*force), high.max(*force))
                });
                assert!(high - low < 0.5 && low > 1.0, "{told}: {low} to {high} N");
            }
        }
    }

    #[test]
    fn away_from_a_surface_and_along_it_a_hand_goes_as_it_likes() {
        let mut contact = Contact::new(ContactArgs::default());
        let (force, place) = (Vector3::new(0.0, 0.0, 8.0), Point3::origin());
        for wanted in [Vector3::new(0.3, -0.2, 0.0), Vector3::new(0.0, 0.1, 0.5)] {
            assert_eq!(contact.allow(&force, &place, wanted), wanted);
        }
        let into = Vector3::new(0.3, 0.0, -0.5);
        let allowed = contact.allow(&force, &place, into);
        assert!(
            (allowed - Vector3::new(0.3, 0.0, 0.0)).norm() < 1e-12,
            "{allowed}"
        );
        // Nothing is felt any more, and the surface is left: it is forgotten.
        let none = Vector3::zeros();
        assert!(contact.allow(&none, &place, into).z > -0.01);
        let left = Point3::new(0.0, 0.0, 0.05);
        assert_eq!(contact.allow(&none, &left, into), into);
        assert_eq!(contact.allow(&none, &place, into), into);
    }
}
