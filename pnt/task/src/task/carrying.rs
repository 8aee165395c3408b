//! How far this net is with what it carries to others. Data only.

use std::{collections::VecDeque, task::Waker};

use ctos::task::Context;

use super::by_net::ByNet;

/// The nets to which something was carried.
#[derive(Default)]
pub(super) struct Carrying {
    pub(super) partners: ByNet<Partner>,
}

/// One of them.
#[derive(Default)]
pub(super) struct Partner {
    pub(super) carrier: Carrier,
    /// Whether it survives its process, once somebody has looked.
    pub(super) durable: Option<bool>,
    /// The contexts of transfers on their way, by number, oldest first.
    pub(super) traces: VecDeque<(u64, Context)>,
}

/// The child that carries to a net.
#[derive(Default)]
pub(super) enum Carrier {
    /// Nothing was carried yet.
    #[default]
    None,
    /// It has all that is needed to go on by itself.
    Busy,
    /// It waits until there is something to carry.
    Waiting(Waker),
}
