//! A number that tells whether two nets have states of the same form. Then what a stored marking,
//! tape and running action refer to by number is the same in both.

use crate::net::{Action, Arc, Does, Net, Outputs, SetTo};

/// Words mixed into one number (FNV-1a), the same on every machine and in every version.
struct Digest(u64);

impl Digest {
    fn word(&mut self, word: &str) {
        for byte in word.bytes().chain([0]) {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    fn arcs(&mut self, kind: &str, net: &Net, arcs: &[Arc]) {
        for arc in arcs {
            self.word(kind);
            self.word(&net[arc.place].name);
            self.word(&arc.weight.to_string());
        }
    }

    fn outputs(&mut self, kind: &str, net: &Net, outputs: &Outputs) {
        self.arcs(kind, net, &outputs.local);
        for arc in &outputs.remote {
            self.word(kind);
            self.word(&arc.net);
            self.word(&arc.place);
            self.word(&arc.weight.to_string());
        }
    }
}

impl Net {
    /// The same for nets that can go on from each other's state: with the same places, commands,
    /// transitions, arcs and actions, in the same order. Limits, priorities, titles, initial tokens and
    /// comments may differ.
    #[must_use]
    pub fn digest(&self) -> u64 {
        *self.digest.get_or_init(|| self.computed_digest())
    }

    fn computed_digest(&self) -> u64 {
        let mut digest = Digest(0xcbf2_9ce4_8422_2325);
        digest.word(self.name());
        for place in self.places() {
            digest.word("place");
            digest.word(&place.name);
        }
        for slot in &self.declared().slots {
            digest.word("data");
            digest.word(&slot.name);
            digest.word(&slot.kind.to_string());
        }
        for command in self.commands() {
            digest.word("command");
            digest.word(&command.symbol);
            for answer in &command.answers {
                digest.word(answer);
            }
        }
        for transition in self.transitions() {
            digest.word("transition");
            digest.word(&transition.name);
            digest.arcs("in", self, &transition.inputs);
            digest.arcs("read", self, &transition.reads);
            digest.arcs("not", self, &transition.inhibitors);
            digest.outputs("out", self, &transition.outputs);
            if let Some(fail) = &transition.fail {
                digest.outputs("fail", self, fail);
            }
            if let Some(command) = transition.tape {
                digest.word("tape");
                digest.word(&self[command].symbol);
            }
            digest.word(transition.write.as_deref().unwrap_or_default());
            match &transition.action {
                None => {}
                Some(Action::Local { function, .. }) => digest.word(function),
                Some(Action::Message { task, command, .. }) => {
                    digest.word(task);
                    digest.word(command);
                }
                Some(Action::Written { does, sets, .. }) => {
                    match does {
                        // How long it waits is a limit of its own.
                        None | Some(Does::Wait(_)) => digest.word("wait"),
                        Some(Does::Request(line) | Does::Log(line)) => digest.word(&line.text),
                    }
                    for set in sets {
                        digest.word(&set.name);
                        digest.word(match &set.to {
                            SetTo::Reply => "reply",
                            SetTo::Value(value) => value.text(),
                        });
                    }
                }
            }
        }
        digest.0
    }
}

#[cfg(test)]
mod tests {
    use ctos::diagnostic::Source;

    use crate::{compile, net::Net};

    fn net(text: &str) -> Net {
        compile::net(&Source::new("n.net", text)).unwrap_or_else(|f| panic!("{f}"))
    }

    const TEXT: &str = "net n\nplace a = 1, b\ncommand go -> gone\ntransition t\n  in a\n  tape go\n  do work\n  out b\n  fail a\n  write gone\ntransition u\n  in b\n  out a\n";

    #[test]
    fn nets_of_another_form_have_another_digest_and_comments_and_tokens_do_not_matter() {
        let digest = net(TEXT).digest();
        let same = TEXT.replace("place a = 1, b", "place a = 2, b # rest");
        assert_eq!(net(&same).digest(), digest);
        for (old, new) in [
            ("in b", "in b*2"),
            ("do work", "do other"),
            ("fail a", "fail b"),
            ("write gone", "out a"),
            ("place a = 1, b", "place b, a = 1"),
            ("transition u", "transition v"),
        ] {
            let changed = net(&TEXT.replace(old, new)).digest();
            assert_ne!(changed, digest, "{old} -> {new}");
        }
    }
}
