//! How the bridge is: in words for `ctos status`, and as a diagnostic for ROS. Knows no network.

use std::collections::BTreeMap;

use crate::{
    graph::Own,
    messages::{DiagnosticStatus, KeyValue},
};

/// No more names are kept that something was wrong with.
const MOST: usize = 100;
/// Of a name the log is told no more often, ns.
const QUIET_NS: u64 = 1_000_000_000;

/// What is wrong with a topic or a service.
#[derive(Debug)]
struct Wrong {
    text: String,
    count: u64,
    /// When the log was told last, ns.
    logged_ns: u64,
}

/// How it is.
#[derive(Debug, Default)]
pub(crate) struct Status {
    /// Whether the network is there, and why not.
    pub there: (bool, String),
    /// Other nodes.
    pub nodes: usize,
    /// Endpoints of others that fit ours.
    pub peers: Vec<(Own, usize)>,
    /// Messages that were not sent, for they came too quickly.
    pub lost: u64,
    /// What was wrong last with a topic or a service, and how often something was.
    wrong: BTreeMap<String, Wrong>,
    /// What was done last by order.
    done: BTreeMap<String, String>,
}

impl Status {
    /// Something is wrong with a topic or a service, at a moment (ns). Whether the log is to be told: of something else
    /// than before, and at most once a second, for a flood of rubbish must not become one of lines.
    pub fn wrong(&mut self, name: &str, text: String, now_ns: u64) -> bool {
        let full = self.wrong.len() >= MOST;
        match self.wrong.get_mut(name) {
            Some(known) => {
                known.count += 1;
                let news = known.text != text && now_ns >= known.logged_ns + QUIET_NS;
                known.text = text;
                if news {
                    known.logged_ns = now_ns;
                }
                news
            }
            None if full => false,
            None => {
                let wrong = Wrong {
                    text,
                    count: 1,
                    logged_ns: now_ns,
                };
                self.wrong.insert(name.to_owned(), wrong);
                true
            }
        }
    }

    /// An order was carried out: what is wrong with it before is past.
    pub fn done(&mut self, name: &str, text: String) {
        self.wrong.remove(name);
        self.done.insert(name.to_owned(), text);
    }

    /// In words, after "it".
    pub fn words(&self) -> String {
        let (there, why) = &self.there;
        let network = match (there, why.as_str()) {
            (true, _) => format!("is among {} other ROS nodes", self.nodes),
            (false, "") => "joins the network of ROS".to_owned(),
            (false, why) => format!("waits for the network of ROS: {why}"),
        };
        let wrong = self.wrong.iter();
        let wrong = wrong
            .map(|(name, Wrong { text, count, .. })| format!("; `{name}`, {count} times: {text}"));
        network + &wrong.collect::<String>()
    }

    /// As a diagnostic called `name`.
    pub fn diagnostic(&self, name: &str, hardware_id: &str) -> DiagnosticStatus {
        let value = |key: String, value: String| KeyValue { key, value };
        let mut values = vec![
            value("nodes".to_owned(), self.nodes.to_string()),
            value("messages lost".to_owned(), self.lost.to_string()),
        ];
        let peers = self.peers.iter();
        values.extend(
            peers.map(|(own, count)| value(format!("peers of {}", own.name), count.to_string())),
        );
        let wrong = self.wrong.iter();
        values.extend(wrong.map(|(name, Wrong { text, count, .. })| {
            value(format!("wrong {name}"), format!("{text} ({count} times)"))
        }));
        values.extend(
            self.done
                .iter()
                .map(|(name, text)| value(format!("done {name}"), text.clone())),
        );
        DiagnosticStatus {
            level: u8::from(!self.wrong.is_empty()),
            name: name.to_owned(),
            message: self.words(),
            hardware_id: hardware_id.to_owned(),
            values,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_told_once_and_not_too_often_and_over_when_an_order_was_carried_out() {
        let mut status = Status {
            there: (true, String::new()),
            ..Status::default()
        };
        assert!(status.wrong("/a", "no CDR".to_owned(), 0));
        assert!(!status.wrong("/a", "no CDR".to_owned(), 2 * QUIET_NS));
        assert!(status.wrong("/a", "no joints".to_owned(), 2 * QUIET_NS));
        assert!(!status.wrong("/a", "7 joints".to_owned(), 2 * QUIET_NS + 1));
        let words = status.words();
        assert!(words.contains("`/a`, 4 times: 7 joints"), "{words}");
        assert_eq!(status.diagnostic("n", "h").level, 1);
        status.done("/a", "the arm is there".to_owned());
        assert_eq!(status.words(), "is among 0 other ROS nodes");
        assert_eq!(status.diagnostic("n", "h").level, 0);
        for number in 0..10_000 {
            status.wrong(&format!("/{number}"), "x".to_owned(), 0);
        }
        assert_eq!(status.wrong.len(), MOST);
    }
}
