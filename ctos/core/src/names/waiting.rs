//! Tasks that wait for names which are not there yet: who waits for whom, and circles among them.

use std::collections::BTreeSet;

use super::{Names, Waiter};
use crate::{envelope::Replier, handled::Handled, system::AwaitTid};

impl Names {
    pub(super) fn wait(&mut self, request: AwaitTid, reply: Replier<AwaitTid>) -> Handled {
        let AwaitTid { name, waiter } = request;
        if let Some(tid) = self.seen_from(reply.asker().chassis(), &name) {
            return reply.ok(Ok(tid));
        }
        self.forget_waiters();
        if let Some(circle) = self.circle(&waiter, &name) {
            return reply.ok(Err(circle));
        }
        let waiter = Waiter {
            name: waiter,
            reply,
        };
        self.waiting.entry(name).or_default().push(waiter);
        Ok(())
    }

    /// Drops those who gave up.
    pub(super) fn forget_waiters(&mut self) {
        for waiters in self.waiting.values_mut() {
            waiters.retain(|waiter| !waiter.reply.is_abandoned());
        }
        self.waiting.retain(|_, waiters| !waiters.is_empty());
    }

    /// The task that would start the task `name`: children are named after their parent.
    fn starter<'n>(&self, name: &'n str) -> Option<&'n str> {
        let mut rest = name;
        while let Some((parent, _)) = rest.rsplit_once('.') {
            if self.names.contains_key(parent) {
                return Some(parent);
            }
            rest = parent;
        }
        None
    }

    /// Whether `waiter`, waiting for `name`, would close a circle: in words.
    fn circle(&self, waiter: &str, name: &str) -> Option<String> {
        let mut seen = BTreeSet::new();
        let mut ways = vec![(name.to_owned(), format!("`{waiter}` waits for `{name}`"))];
        while let Some((wanted, so_far)) = ways.pop() {
            let Some(starter) = self.starter(&wanted) else {
                continue;
            };
            let so_far = format!("{so_far}, which `{starter}` would start");
            if starter == waiter {
                return Some(so_far);
            }
            if !seen.insert(starter.to_owned()) {
                continue;
            }
            for (next, waiters) in &self.waiting {
                if waiters.iter().any(|other| other.name == starter) {
                    let way = format!("{so_far}, but `{starter}` waits for `{next}`");
                    ways.push((next.clone(), way));
                }
            }
        }
        None
    }

    pub(super) fn who_waits(&mut self, name: &str) -> String {
        self.forget_waiters();
        let mut text = match (self.past.get(name), self.starter(name)) {
            (Some(_), _) => "it was there and has ended".to_owned(),
            (None, Some(starter)) => format!("`{starter}`, which would start it, has not"),
            (None, None) => "nobody ever had this name".to_owned(),
        };
        if let Some(starter) = self.starter(name) {
            for (wanted, waiters) in &self.waiting {
                if waiters.iter().any(|waiter| waiter.name == starter) {
                    text.push_str(&format!("; `{starter}` waits for `{wanted}`"));
                }
            }
        }
        let others = self.waiting.get(name).into_iter().flatten();
        let others: Vec<String> = others.map(|waiter| format!("`{}`", waiter.name)).collect();
        if !others.is_empty() {
            text.push_str(&format!("; {} waits for it too", others.join(", ")));
        }
        text
    }
}
