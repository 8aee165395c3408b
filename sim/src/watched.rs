//! What moves by forces, for those who look on: where objects are, and what touches the arms. The world shows it after each tick
//! for as long as somebody looks, and not otherwise.

use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use mcs::latest::Latest;

use crate::{cell::Cell, world::World};

/// After a look the world shows for so many ticks more.
const TICKS: u64 = 400;

/// Objects and contacts of one world.
#[derive(Debug)]
pub struct Watched {
    /// The tick up to which somebody looks.
    until: AtomicU64,
    tick: AtomicU64,
    /// Each with a place and a turn: x, y, z, then x, y, z, w.
    objects: Vec<Latest>,
    /// Of each link in [`Cell::touchable`]: whether something touches it, where, and the force on it.
    contacts: Vec<Latest>,
}

/// A contact: the middle of its points, m, and the force on the link, N; world.
pub type Contact = (Point3<f64>, Vector3<f64>);

fn row(pose: &Isometry3<f64>) -> [f64; 7] {
    let (at, turn) = (&pose.translation, &pose.rotation);
    [at.x, at.y, at.z, turn.i, turn.j, turn.k, turn.w]
}

impl Watched {
    /// The objects of `cell` at their starts, and nothing that touches an arm.
    pub(crate) fn new(cell: &Cell) -> Self {
        let objects = cell.objects.iter();
        Self {
            until: AtomicU64::new(0),
            tick: AtomicU64::new(0),
            objects: objects
                .map(|object| Latest::new(&row(&object.start)))
                .collect(),
            contacts: cell.touchable().map(|_| Latest::new(&[0.0; 7])).collect(),
        }
    }

    /// Somebody looks now.
    pub(crate) fn look(&self) {
        let until = self.tick.load(Ordering::Relaxed) + TICKS;
        self.until.store(until, Ordering::Relaxed);
    }

    /// The world shows what there is, if somebody looks.
    pub(crate) fn show(&self, tick: u64, world: &World) {
        self.tick.store(tick, Ordering::Relaxed);
        if tick > self.until.load(Ordering::Relaxed) {
            return;
        }
        for (latest, pose) in self.objects.iter().zip(world.objects()) {
            latest.write(row(&pose));
        }
        for (latest, contact) in self.contacts.iter().zip(world.contacts()) {
            let touches = f64::from(u8::from(contact.is_some()));
            let (at, force) = contact.unwrap_or_default();
            latest.write([touches, at.x, at.y, at.z, force.x, force.y, force.z]);
        }
    }

    /// Where an object was last.
    pub(crate) fn object(&self, index: usize) -> Isometry3<f64> {
        let mut row = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        if let Some(latest) = self.objects.get(index) {
            latest.read(&mut row);
        }
        let [x, y, z, i, j, k, w] = row;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        Isometry3::from_parts(Translation3::new(x, y, z), turn)
    }

    /// What touched each link last.
    pub(crate) fn contacts(&self) -> impl Iterator<Item = Option<Contact>> {
        self.contacts.iter().map(|latest| {
            let mut row = [0.0; 7];
            latest.read(&mut row);
            let [touches, x, y, z, fx, fy, fz] = row;
            (touches > 0.5).then(|| (Point3::new(x, y, z), Vector3::new(fx, fy, fz)))
        })
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::Arc, time::Duration};

    use ctos::diagnostic::Source;

    use super::*;
    use crate::{port::Port, simulation::Simulation};

    const TICK: Duration = Duration::from_micros(1500);
    /// A box above the shoulder of an arm that its brakes hold, and one on the floor.
    const CELL: &str = "[[arm]]\nname = 'puma'\nmodel = 'puma560'\nstart = [0.0, 45.0, -90.0, 0.0, 45.0, 0.0]\n\
        [[object]]\nname = 'falling'\nshape = 'box'\nsize = [0.2, 0.2, 0.05]\nmass = 0.5\nfriction = 0.5\ngrey = 100.0\nposition = [0.0, 0.0, 1.3]\n\
        [[object]]\nname = 'lying'\nshape = 'box'\nsize = [0.1, 0.1, 0.1]\nmass = 0.5\nfriction = 0.5\ngrey = 100.0\nposition = [1.5, 1.0, 0.05]\n\
        [room]\nfloor_grey = 24.0\n";

    #[test]
    fn objects_and_what_touches_an_arm_are_shown_while_somebody_looks_and_not_otherwise() {
        let cell = Cell::parse(&Source::new("cell.toml", CELL)).unwrap_or_else(|f| panic!("{f}"));
        let port = Arc::new(Port::new(&cell));
        let mut simulation = Simulation::new(&cell, Arc::clone(&port));
        let mut now = Duration::ZERO;
        let mut ticks = |count: u64| {
            for _ in 0..count {
                now += TICK;
                simulation.tick(TICK, 0, now).unwrap();
            }
        };
        let height = || port.watched.object(0).translation.z;
        // Nobody looks: it falls, and nobody is told.
        ticks(TICKS + 20);
        assert_eq!(height(), 1.3);
        port.watched.look();
        ticks(1);
        assert!(height() < 1.2, "{}", height());
        assert!((port.watched.object(1).translation.z - 0.05).abs() < 0.01);
        // It lies on the arm, or has slid down on one of its links meanwhile.
        let mut touched = Vec::new();
        for _ in 0..40 {
            port.watched.look();
            ticks(20);
            touched.extend(port.watched.contacts().flatten());
        }
        let (middle, force) = touched.first().expect("nothing ever touched the arm");
        assert!(middle.z > 0.3 && middle.coords.norm() < 1.5, "{middle}");
        // Whom brakes hold feels nothing.
        assert_eq!(*force, Vector3::zeros());
        // Once nobody looks any more, the last that was seen stays.
        ticks(TICKS);
        let seen = port.watched.object(0);
        ticks(200);
        assert_eq!(port.watched.object(0), seen);
    }
}
