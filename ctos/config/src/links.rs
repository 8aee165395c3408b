//! What the configuration says of links: how chassis of one host are joined, and how long a peer
//! may be silent. Also which faults are injected, and whose keys count.

use std::{net::IpAddr, path::PathBuf, time::Duration};

use serde::Deserialize;

use super::{
    app::ChassisConfig,
    check::defaults,
    node::Node,
    zenoh::{self, ZenohConfig},
};
use crate::{
    diagnostic::{Finding, Findings},
    settings::BOOT_CHASSIS,
};

const SPIN: Duration = Duration::from_micros(5);

/// How chassis of one host are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SameHost {
    /// By shared memory, with a Unix socket that shows when one of them ends.
    #[default]
    #[serde(rename = "shm")]
    Shared,
    /// By Unix sockets.
    Unix,
    /// By TCP over the loopback.
    Tcp,
    /// By the network of `[zenoh]`.
    Zenoh,
}

/// How links behave.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkConfig {
    /// A peer that is silent for so long is given up.
    pub peer_timeout: Duration,
    /// How chassis of one host are joined.
    pub same_host: SameHost,
    /// How long a reader of shared memory looks before it sleeps.
    pub spin: Duration,
    /// How many bytes of requests, and of answers, may be unacknowledged by one peer.
    pub unacknowledged: usize,
    /// The network that joins chassis of different hosts, if there is one.
    pub zenoh: Option<ZenohConfig>,
    /// What goes wrong on purpose.
    pub injury: InjuryConfig,
}

impl Default for LinkConfig {
    fn default() -> Self {
        links(&defaults(), &[], &mut Findings::new())
    }
}

impl LinkConfig {
    /// For how long this process looks before it sleeps.
    #[must_use]
    pub fn spin_here(&self) -> Duration {
        // With one CPU the one for which a spinning reader waits could not run.
        match std::thread::available_parallelism() {
            Ok(count) if count.get() > 1 => self.spin,
            _ => Duration::ZERO,
        }
    }
}

/// What goes wrong on purpose with the links of an app, to see what becomes of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct InjuryConfig {
    /// The probability that a packet is lost, 0 to 0.9.
    pub drop: f64,
    /// How much later than it could each packet leaves, least and most.
    pub delay: (Duration, Duration),
    /// When which links are cut.
    pub cuts: Vec<Cut>,
    /// After how many bytes the first stream of a link breaks, on average; 0 = never. Each further one
    /// lives longer.
    pub break_bytes: usize,
}

impl InjuryConfig {
    /// Whether nothing goes wrong.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// A link that is cut for a while.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cut {
    /// One end: a chassis, or `boot`.
    pub one: String,
    /// The other end.
    pub other: String,
    /// From when, since the start of the app.
    pub at: Duration,
    /// Until when, since the start of the app.
    pub until: Duration,
}

impl Cut {
    /// Whether it is the link of these two.
    #[must_use]
    pub fn is_between(&self, a: &str, b: &str) -> bool {
        let ends = (self.one.as_str(), self.other.as_str());
        ends == (a, b) || ends == (b, a)
    }

    /// Reads `ONE:OTHER@TIME` or `ONE:OTHER@TIME+TIME`.
    fn parse(text: &str) -> Option<Self> {
        let (ends, when) = text.rsplit_once('@')?;
        let (one, other) = ends.split_once(':')?;
        let (at, until) = match when.split_once('+') {
            Some((at, lasts)) => {
                let at = duration(at)?;
                (at, at.saturating_add(duration(lasts)?))
            }
            None => (duration(when)?, Duration::MAX),
        };
        (one != other).then(|| Self {
            one: one.to_owned(),
            other: other.to_owned(),
            at,
            until,
        })
    }
}

/// Reads `2s`, `5ms`, `50us`.
fn duration(text: &str) -> Option<Duration> {
    let unit = text.find(|letter: char| letter.is_ascii_alphabetic())?;
    let (number, unit) = text.split_at_checked(unit)?;
    let scale = match unit {
        "s" => 1.0,
        "ms" => 1e-3,
        "us" => 1e-6,
        _ => return None,
    };
    let seconds = number.parse::<f64>().ok()? * scale;
    (0.0..=86_400.0)
        .contains(&seconds)
        .then(|| Duration::from_secs_f64(seconds))
}

/// Reads `5ms` or `5ms..20ms`.
fn delay(text: &str) -> Option<(Duration, Duration)> {
    let (least, most) = text.split_once("..").unwrap_or((text, text));
    let delay = (duration(least)?, duration(most)?);
    (delay.0 <= delay.1).then_some(delay)
}

/// Whose keys count beyond this host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SecurityConfig {
    /// The key of this app's chassis, without its ending.
    pub key: PathBuf,
    /// The certificate of the authority that signs all keys.
    pub authority: PathBuf,
}

/// Reads what belongs to links.
pub(super) fn links(root: &Node, chassis: &[ChassisConfig], findings: &mut Findings) -> LinkConfig {
    let spin = root.read("app.spin_us").map(Duration::from_micros);
    let unacknowledged = root.read::<usize>("app.link_unacknowledged_mib");
    LinkConfig {
        peer_timeout: root.seconds("app.peer_timeout_s").unwrap_or_default(),
        same_host: root.read("app.same_host").unwrap_or_default(),
        spin: spin.unwrap_or(SPIN),
        unacknowledged: unacknowledged.unwrap_or_default() << 20,
        zenoh: zenoh::zenoh(root, findings),
        injury: injury(root, chassis, findings),
    }
}

fn injury(root: &Node, chassis: &[ChassisConfig], findings: &mut Findings) -> InjuryConfig {
    let late = root.get("injure.delay").and_then(|node| {
        let delay = node.as_str().and_then(delay);
        if delay.is_none() {
            let finding = Finding::error("ctos::config::value", "[injure]: `delay` cannot be read")
                .help("write a time such as \"5ms\", or a range such as \"5ms..20ms\"");
            findings.push(finding.at(node.place.clone()));
        }
        delay
    });
    let cuts = root.get("injure.cut").map_or(&[][..], Node::elements);
    InjuryConfig {
        drop: root.read("injure.drop").unwrap_or_default(),
        delay: late.unwrap_or_default(),
        cuts: all_cuts(cuts, chassis, findings),
        break_bytes: root.read("injure.break_bytes").unwrap_or_default(),
    }
}

fn all_cuts(texts: &[Node], chassis: &[ChassisConfig], findings: &mut Findings) -> Vec<Cut> {
    let names = || {
        let names = chassis.iter().map(|chassis| chassis.name.as_str());
        names.chain([BOOT_CHASSIS])
    };
    let mut cuts = Vec::new();
    for text in texts {
        let mut push = |finding: Finding| findings.push(finding.at(text.place.clone()));
        let Some(cut) = text.as_str().and_then(Cut::parse) else {
            let finding = Finding::error("ctos::config::value", "[injure]: a `cut` cannot be read");
            let help = "write two chassis, when, and for how long: \"a:b@2s\", \"a:boot@2s+0.5s\"";
            push(finding.help(help));
            continue;
        };
        for end in [&cut.one, &cut.other] {
            if !names().any(|name| name == end) {
                let text = format!("[injure]: there is no chassis `{end}` to cut off");
                push(Finding::error("ctos::config::unknown_chassis", text).suggest(end, names()));
            }
        }
        cuts.push(cut);
    }
    cuts
}

/// Reads `[security]`.
pub(super) fn security(root: &Node) -> Option<SecurityConfig> {
    Some(SecurityConfig {
        key: root.read("security.key")?,
        authority: root.read("security.authority")?,
    })
}

/// What to do where keys are missing.
pub(super) const KEYS_HELP: &str =
    "make keys with `ctos keys new keys/NAME --role boot` and name them in [security]";

/// Whether only this host can call it.
pub(super) fn is_loopback(address: IpAddr) -> bool {
    address.to_canonical().is_loopback()
}

#[cfg(test)]
mod tests {
    use crate::load_texts;

    use super::*;

    const APP: &str = "[task.t]\nhandler = \"h\"\non = \"a\"\n[chassis.a]\n";

    fn app(more: &str) -> crate::App {
        let text = format!("{APP}{more}");
        load_texts(&[("app.toml", &text)], &[], &[])
            .map_err(|found| found.to_string())
            .unwrap()
    }

    fn refused(more: &str) -> String {
        let text = format!("{APP}{more}");
        load_texts(&[("app.toml", &text)], &[], &[])
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_is_left_out_is_as_it_is_without_injuries_and_keys() {
        let app = app("");
        assert_eq!(app.links, LinkConfig::default());
        assert!(app.links.injury.is_none() && app.security.is_none());
    }

    #[test]
    fn links_injuries_and_keys_are_read() {
        let app = app(r#"
            [app]
            peer_timeout_s = 0.5
            same_host = "tcp"
            spin_us = 0
            link_unacknowledged_mib = 3
            [injure]
            drop = 0.25
            delay = "5ms..20ms"
            cut = ["a:boot@2s+0.5s", "a:boot@3s"]
            break_bytes = 1000
            [security]
            key = "keys/a"
            authority = "keys/ca.pem"
            "#);
        assert_eq!(app.links.peer_timeout, Duration::from_millis(500));
        assert_eq!(
            (app.links.same_host, app.links.spin),
            (SameHost::Tcp, Duration::ZERO)
        );
        assert_eq!(app.links.unacknowledged, 3 << 20);
        let injury = &app.links.injury;
        assert_eq!((injury.drop, injury.break_bytes), (0.25, 1000));
        let delay = (Duration::from_millis(5), Duration::from_millis(20));
        assert_eq!(injury.delay, delay);
        let ends = injury
            .cuts
            .iter()
            .map(|cut| (cut.at.as_secs_f64(), cut.until.as_secs_f64()));
        let expected = [(2.0, 2.5), (3.0, Duration::MAX.as_secs_f64())];
        assert_eq!(ends.collect::<Vec<_>>(), expected);
        assert!(injury.cuts[0].is_between("boot", "a"));
        let security = app.security.unwrap();
        assert_eq!(security.key, std::path::Path::new("keys/a"));
    }

    #[test]
    fn an_address_that_others_can_reach_needs_keys() {
        for listen in [
            "0.0.0.0:7000",
            "192.168.1.5:0",
            "[::]:0",
            "[::ffff:10.0.0.1]:0",
        ] {
            let found = refused(&format!("listen = \"{listen}\"\n"));
            assert!(
                found.contains("has no keys") && found.contains("app.toml:5:1"),
                "{found}"
            );
            let keys = "[security]\nkey = \"keys/a\"\nauthority = \"keys/ca.pem\"";
            app(&format!("listen = \"{listen}\"\n{keys}"));
        }
        for listen in ["127.0.0.1:0", "[::1]:0", "[::ffff:127.0.0.1]:0"] {
            app(&format!("listen = \"{listen}\"\n"));
        }
    }

    #[test]
    fn what_cannot_be_meant_is_found_with_its_place() {
        for (text, says) in [
            ("[injure]\ndrop = 1.5", "from 0 to 0.9"),
            ("[injure]\ndelay = \"soon\"", "`delay` cannot be read"),
            ("[injure]\ndelay = \"20ms..5ms\"", "`delay` cannot be read"),
            ("[injure]\ncut = \"a:b@2s\"", "`cut` must be a list"),
            ("[injure]\ncut = [\"a@2s\"]", "a `cut` cannot be read"),
            ("[injure]\ncut = [\"a:a@2s\"]", "a `cut` cannot be read"),
            ("[injure]\ncut = [3]", "a `cut` cannot be read"),
            ("[injure]\ncut = [\"a:boott@2s\"]", "did you mean `boot`"),
            ("[injure]\ndrops = 0.1", "unknown key `drops`"),
            ("[security]\nkey = \"k\"", "has no `authority`"),
            ("[app]\nsame_host = \"sm\"", "unknown choice `sm`"),
        ] {
            let found = refused(text);
            assert!(
                found.contains(says) && found.contains("app.toml:"),
                "{text}: {found}"
            );
        }
    }

    #[test]
    fn times_are_read_with_their_units() {
        assert_eq!(duration("1.5s"), Some(Duration::from_millis(1500)));
        assert_eq!(duration("50us"), Some(Duration::from_micros(50)));
        for text in ["", "s", "5", "5m", "-1s", "1e9s", "nans", "infs"] {
            assert_eq!(duration(text), None, "{text}");
        }
    }
}
