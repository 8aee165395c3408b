//! Tasks that wait for names which are not there yet: who waits for whom, and circles among them.

use std::collections::BTreeSet;

use super::{Names, Waiter};
use crate::{envelope::Replier, handled::Handled, system::AwaitTid};

impl Waiter {
    fn has_given_up(&self) -> bool {
        self.reply.is_abandoned()
    }
}

impl Names {
    pub(super) fn wait(&mut self, request: AwaitTid, reply: Replier<AwaitTid>) -> Handled {
        let AwaitTid { name, waiter } = request;
        if let Some(tid) = self.seen_from(reply.asker().chassis(), &name) {
            return reply.ok(Ok(tid));
        }
        if let Some(circle) = self.circle(&waiter, &name) {
            return reply.ok(Err(circle));
        }
        let waiter = Waiter {
            name: waiter,
            reply,
        };
        self.waiting.push(name, waiter, Waiter::has_given_up);
        Ok(())
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
            for next in self.awaited_by(starter) {
                let way = format!("{so_far}, but `{starter}` waits for `{next}`");
                ways.push((next.to_owned(), way));
            }
        }
        None
    }

    /// The names that the task `waiter` waits for, each once.
    fn awaited_by(&self, waiter: &str) -> BTreeSet<&str> {
        let all = self.waiting.iter();
        let own = all.filter(|(_, one)| one.name == waiter && !one.has_given_up());
        own.map(|(wanted, _)| wanted).collect()
    }

    pub(super) fn who_waits(&mut self, name: &str) -> String {
        self.waiting.forget(Waiter::has_given_up);
        let mut text = match (self.past.get(name), self.starter(name)) {
            (Some(_), _) => "it was there and has ended".to_owned(),
            (None, Some(starter)) => format!("`{starter}`, which would start it, has not"),
            (None, None) => "nobody ever had this name".to_owned(),
        };
        if let Some(starter) = self.starter(name) {
            for wanted in self.awaited_by(starter) {
                text.push_str(&format!("; `{starter}` waits for `{wanted}`"));
            }
        }
        let others = self.waiting.of(name);
        let others: Vec<String> = others.map(|waiter| format!("`{}`", waiter.name)).collect();
        if !others.is_empty() {
            text.push_str(&format!("; {} waits for it too", others.join(", ")));
        }
        text
    }
}
