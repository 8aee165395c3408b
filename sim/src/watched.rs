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
