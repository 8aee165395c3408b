//! Who belongs to the app: the boot tells all of all, and each makes a link to another one when it first needs it.

use std::{collections::BTreeMap, sync::Arc};

use super::{Inner, MeshEvent, Notice, Peer};
use ctos_link::{
    handshake::Member,
    session::{
        DownReason, Session,
        state::{Event, State},
    },
};
use ctos_message::ChassisNumber;
use ctos_time::lock::lock;

impl Peer {
    /// Whether it is connected. One that has just lost its stream is a member all the same.
    fn is_up(&self) -> bool {
        let session = self.session.as_ref();
        session.is_some_and(|session| matches!(session.state(), State::Up | State::Broken))
    }
}

impl Inner {
    /// At the boot: a link came up, or went down. When everybody who is expected has called, all are told of all; one who
    /// leaves is no news.
    pub(super) fn changed(&self) {
        if self.chassis.index() != 0 {
            return;
        }
        let mut state = lock(&self.state);
        let expected = |peer: &&Peer| {
            let session = peer.session.as_ref();
            session.is_none_or(|session| session.state() != State::Down)
        };
        let mut peers = state.peers.values().filter(expected);
        if !peers.all(|peer| peer.is_up() && peer.member.is_some()) {
            return;
        }
        let up = || state.peers.values().filter(|peer| peer.is_up());
        let members: Vec<Member> = up().filter_map(|peer| peer.member.clone()).collect();
        let sessions: Vec<_> = up().filter_map(|peer| peer.session.clone()).collect();
        let there = members
            .iter()
            .map(|member| (member.chassis, member.incarnation));
        let there: BTreeMap<ChassisNumber, u32> = there.collect();
        let before = std::mem::replace(&mut state.announced, there.clone());
        let is_new = |(one, life): &(ChassisNumber, u32)| before.get(one) != Some(life);
        let come: Vec<_> = there.into_iter().filter(is_new).collect();
        if come.is_empty() {
            return;
        }
        // Under the lock: who is asked to call another one has heard of it before.
        let notice = Notice::Members(members);
        for session in sessions {
            tell(&session, &notice);
        }
        drop(state);
        for (chassis, incarnation) in come {
            self.send(MeshEvent::Joined {
                chassis,
                incarnation,
            });
        }
    }

    /// Makes the link with `chassis` on its first use, if the boot has told of it. It takes frames at once, and is down
    /// when no stream can be had.
    pub(super) fn connect(self: &Arc<Self>, chassis: ChassisNumber) {
        let member = {
            let state = lock(&self.state);
            let peer = state.peers.get(&chassis);
            peer.and_then(|peer| peer.member.clone())
        };
        let Some(member) = member else { return };
        if let Some(session) = self.call(member.clone()) {
            self.enlist(chassis, member.incarnation, &session);
        }
    }

    /// From now on frames for `chassis` go over `session`, and those of an earlier incarnation nowhere.
    pub(super) fn enlist(&self, chassis: ChassisNumber, incarnation: u32, session: &Arc<Session>) {
        let unlinked = {
            let mut live = lock(&self.live);
            let before = live.get(&chassis).copied();
            // It may have gone down just now, and would not tell that again; or its successor was faster.
            let is_over = session.look(|core| core.state()) == State::Down;
            if is_over || before.is_some_and(|before| before > incarnation) {
                return;
            }
            live.insert(chassis, incarnation);
            let replaced = before.is_some_and(|before| before != incarnation);
            let unlinked = replaced.then(|| self.chassis.unlink(chassis)).flatten();
            self.chassis.link_up(chassis, session.clone());
            unlinked
        };
        if let Some(unlinked) = unlinked {
            self.chassis.tell_unlinked(unlinked);
        }
    }

    /// What the mesh of `from` says.
    pub(super) fn heard(self: &Arc<Self>, from: ChassisNumber, notice: Notice) {
        match notice {
            Notice::Members(members) if from == 0 => self.learn(members),
            Notice::Call(chassis, _) if from == 0 => self.connect(chassis),
            Notice::Gone(chassis, incarnation) if from == 0 => {
                let session = {
                    let state = lock(&self.state);
                    let peer = state.peers.get(&chassis);
                    let peer = peer.filter(|peer| peer.incarnation == incarnation);
                    peer.and_then(|peer| peer.session.clone())
                };
                if let Some(session) = session {
                    session.event(Event::PeerEnded, DownReason::Ended);
                }
            }
            Notice::Call(chassis, incarnation) if self.chassis.index() == 0 => {
                self.pass_on(from, (chassis, incarnation));
            }
            other => {
                let peer = self.chassis.name_of(from);
                tracing::error!(peer, notice = ?other, "not for this chassis to hear");
            }
        }
    }

    /// These belong to the app now. Of their earlier incarnations nothing is left.
    fn learn(self: &Arc<Self>, members: Vec<Member>) {
        let ours = self.chassis.index();
        for member in members {
            if member.chassis != ours && self.supersede(member.chassis, member.incarnation) {
                self.introduce(member);
            }
        }
        self.send(MeshEvent::Joined {
            chassis: ours,
            incarnation: self.who.incarnation,
        });
    }

    /// At the boot: `from` wants to be called by an incarnation of `chassis`. That is asked to, if it is there.
    fn pass_on(&self, from: ChassisNumber, (chassis, incarnation): (ChassisNumber, u32)) {
        let (asker, asked) = {
            let state = lock(&self.state);
            let asked = state.peers.get(&chassis);
            let asked = asked.filter(|peer| peer.incarnation == incarnation && peer.is_up());
            let asker = state.peers.get(&from);
            (
                asker.and_then(|peer| Some((peer.session.clone()?, peer.incarnation))),
                asked.and_then(|peer| peer.session.clone()),
            )
        };
        match (asked, asker) {
            (Some(asked), Some((_, life))) => tell(&asked, &Notice::Call(from, life)),
            (None, Some((asker, _))) => tell(&asker, &Notice::Gone(chassis, incarnation)),
            (_, None) => {}
        }
    }

    /// Asks `member`, by way of the boot, to call this chassis.
    pub(super) fn ask_to_be_called(&self, member: &Member) {
        let boot = {
            let state = lock(&self.state);
            state.peers.get(&0).and_then(|boot| boot.session.clone())
        };
        if let Some(boot) = boot {
            tell(&boot, &Notice::Call(member.chassis, member.incarnation));
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
