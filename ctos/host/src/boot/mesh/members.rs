//! Who belongs to the app: the boot tells all of all, and hears when they are connected.

use std::{collections::BTreeMap, sync::Arc};

use super::{Inner, MeshEvent, Notice, Peer, calls};
use ctos_link::{
    handshake::Member,
    session::{Session, state::State},
};
use ctos_message::ChassisNumber;
use ctos_time::lock::lock;

impl Inner {
    /// A link came up, or went down.
    pub(super) fn changed(self: &Arc<Self>) {
        if self.chassis.index() == 0 {
            self.announce();
        } else {
            self.report();
        }
    }

    /// At the boot: when everybody who is expected has called, all are told of all. One who leaves is no news, unless
    /// somebody may wait to be connected to it: an app that ends would else tell all of all each time that one goes.
    fn announce(&self) {
        let (notice, sessions) = {
            let mut state = lock(&self.state);
            let is_up = |peer: &Peer| {
                let session = peer.session.as_ref();
                // One that has just lost its stream is a member all the same.
                session.is_some_and(|session| matches!(session.state(), State::Up | State::Broken))
            };
            let expected = |peer: &&Peer| {
                let session = peer.session.as_ref();
                session.is_none_or(|session| session.state() != State::Down)
            };
            let mut peers = state.peers.values().filter(expected);
            if !peers.all(|peer| is_up(peer) && peer.member.is_some()) {
                return;
            }
            let up = || state.peers.values().filter(|peer| is_up(peer));
            let there = up().filter_map(|peer| peer.member.as_ref());
            let there = there.map(|member| (member.chassis, member.incarnation));
            let there: BTreeMap<ChassisNumber, u32> = there.collect();
            let before = &state.announced;
            let has_come = there
                .iter()
                .any(|(one, life)| before.get(one) != Some(life));
            let has_left = before.keys().any(|one| !there.contains_key(one));
            let waits = there.keys().any(|one| !state.ready.contains(one));
            let is_news = has_come || (has_left && waits);
            if !is_news {
                state.announced = there;
                return;
            }
            let round = state.round + 1;
            let members = up().filter_map(|peer| peer.member.clone()).collect();
            let sessions: Vec<_> = up().filter_map(|peer| peer.session.clone()).collect();
            state.round = round;
            state.announced = there;
            state.ready.clear();
            (Notice::Members { round, members }, sessions)
        };
        for session in sessions {
            tell(&session, &notice);
        }
    }

    /// Elsewhere: when all members are connected, or gone again, the boot is told.
    fn report(&self) {
        let (round, boot) = {
            let mut state = lock(&self.state);
            let Some(awaited) = &state.awaited else {
                return;
            };
            let connected = |member: &Member| {
                let Some(peer) = state.peers.get(&member.chassis) else {
                    return false;
                };
                let session = peer.session.as_ref();
                let met = session.is_some_and(|session| session.state() != State::Waiting);
                peer.incarnation > member.incarnation
                    || peer.incarnation == member.incarnation && met
            };
            let ours = self.chassis.index();
            let mut others = awaited.iter().filter(|member| member.chassis != ours);
            if !others.all(connected) {
                return;
            }
            state.awaited = None;
            let boot = state.peers.get(&0).and_then(|peer| peer.session.clone());
            (state.round, boot)
        };
        if let Some(boot) = boot {
            tell(&boot, &Notice::Ready { round });
        }
        self.send(MeshEvent::Joined {
            chassis: self.chassis.index(),
            incarnation: self.who.incarnation,
        });
    }

    /// What the mesh of `chassis` says.
    pub(super) fn heard(self: &Arc<Self>, chassis: ChassisNumber, notice: Notice) {
        match notice {
            Notice::Members { round, members } if chassis == 0 => {
                let ours = (self.chassis.index(), self.who.incarnation);
                for member in &members {
                    let theirs = (member.chassis, member.incarnation);
                    if theirs.0 != ours.0 && calls(ours, theirs) {
                        self.call(member.clone());
                    }
                }
                {
                    let mut state = lock(&self.state);
                    state.round = round;
                    state.awaited = Some(members);
                }
                self.report();
            }
            Notice::Ready { round } if self.chassis.index() == 0 => {
                let incarnation = {
                    let mut state = lock(&self.state);
                    let known = state.peers.get(&chassis).map(|peer| peer.incarnation);
                    let Some(incarnation) = known.filter(|_| round == state.round) else {
                        return;
                    };
                    state.ready.insert(chassis);
                    incarnation
                };
                self.send(MeshEvent::Joined {
                    chassis,
                    incarnation,
                });
            }
            other => {
                let peer = self.chassis.name_of(chassis);
                tracing::error!(peer, notice = ?other, "not for this chassis to hear");
            }
        }
    }
}

/// Sends a message of the mesh.
fn tell(session: &Session, notice: &Notice) {
    match postcard::to_stdvec(notice) {
        Ok(bytes) => session.notify(bytes),
        Err(error) => tracing::error!(error = %error, "a message of the mesh cannot be written"),
    }
}
