//! What `[zenoh]` says: the network by which the chassis of an app find and reach each other. It is for
//! more machines than one lists by hand.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    str::FromStr,
};

use super::{
    links::{KEYS_HELP, SameHost, is_loopback},
    node::Node,
};
use crate::diagnostic::{Finding, Findings, Place};
use serde::Deserialize;

/// Whether this program was built with links over zenoh.
#[must_use]
pub const fn has_zenoh() -> bool {
    cfg!(feature = "zenoh")
}

/// How the processes of an app take part in a zenoh network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ZenohConfig {
    /// What they are in it.
    pub mode: ZenohMode,
    /// Whom each process connects to: routers, or peers that know others.
    pub connect: Vec<ZenohEndpoint>,
    /// Where each process (as a router: the boot) can be connected to.
    pub listen: Vec<ZenohEndpoint>,
    /// The interface on which they find each other by multicast; `None` = they do not.
    pub multicast: Option<String>,
}

/// What the processes of an app are in a zenoh network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ZenohMode {
    /// Each connects to every other one that it hears of.
    #[default]
    Peer,
    /// All go through a router.
    Client,
    /// The process that boots is the router of the others.
    Router,
}

/// Where a connection of the network is made: `tcp/HOST:PORT` or `tls/HOST:PORT`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ZenohEndpoint {
    /// Whether both ends show keys.
    pub tls: bool,
    /// A name, or an address without brackets.
    pub host: String,
    /// The port; 0 = a free one.
    pub port: u16,
}

impl ZenohEndpoint {
    fn ip(&self) -> Option<IpAddr> {
        self.host.parse().ok()
    }

    fn is_loopback(&self) -> bool {
        self.ip().map_or(self.host == "localhost", is_loopback)
    }
}

impl fmt::Display for ZenohEndpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let protocol = if self.tls { "tls" } else { "tcp" };
        match self.ip() {
            Some(ip) => write!(f, "{protocol}/{}", SocketAddr::new(ip, self.port)),
            None => write!(f, "{protocol}/{}:{}", self.host, self.port),
        }
    }
}

/// A text that is not an endpoint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not an endpoint; write tcp/HOST:PORT or tls/HOST:PORT")]
pub struct ZenohEndpointError(String);

impl FromStr for ZenohEndpoint {
    type Err = ZenohEndpointError;

    fn from_str(text: &str) -> Result<Self, ZenohEndpointError> {
        let wrong = || ZenohEndpointError(text.to_owned());
        let (tls, address) = match text.split_once('/').ok_or_else(wrong)? {
            ("tcp", address) => (false, address),
            ("tls", address) => (true, address),
            _ => return Err(wrong()),
        };
        if let Ok(address) = address.parse::<SocketAddr>() {
            return Ok(Self {
                tls,
                host: address.ip().to_string(),
                port: address.port(),
            });
        }
        let (host, port) = address.rsplit_once(':').ok_or_else(wrong)?;
        let letter = |letter: char| letter.is_ascii_alphanumeric() || "-.".contains(letter);
        if host.is_empty() || host.len() > 253 || !host.chars().all(letter) {
            return Err(wrong());
        }
        Ok(Self {
            tls,
            host: host.to_owned(),
            port: port.parse().map_err(|_| wrong())?,
        })
    }
}

const NOBODY_HELP: &str = "add [zenoh] with connect = [\"tls/HOST:7447\"] for a router, or mode = \"router\" with listen, or multicast = \"lo\"";
const ENDPOINTS_HELP: &str = "write a list such as [\"tls/10.0.0.5:7447\"]";

/// Reads `[zenoh]` and finds what does not fit together in it; `None` where it says nothing.
pub(super) fn zenoh(root: &Node, findings: &mut Findings) -> Option<ZenohConfig> {
    if root.tables("zenoh").is_empty() {
        if root.read("app.same_host") == Some(SameHost::Zenoh) {
            let text = "`same_host = \"zenoh\"` joins chassis over a network that is not described";
            findings.push(wrong(text, NOBODY_HELP, root.locate("app.same_host")));
        }
        return None;
    }
    let asked = Asked {
        root,
        mode: root.read("zenoh.mode").unwrap_or_default(),
        connect: endpoints(root, "connect", findings),
        listen: endpoints(root, "listen", findings),
        multicast: root.read("zenoh.multicast"),
    };
    asked.check(findings);
    let bare = |list: Vec<(ZenohEndpoint, Place)>| -> Vec<_> {
        list.into_iter().map(|(endpoint, _)| endpoint).collect()
    };
    let mut listen = bare(asked.listen);
    if listen.is_empty() {
        listen.push(ZenohEndpoint {
            tls: false,
            host: Ipv4Addr::LOCALHOST.to_string(),
            port: 0,
        });
    }
    Some(ZenohConfig {
        mode: asked.mode,
        connect: bare(asked.connect),
        listen,
        multicast: asked.multicast,
    })
}

/// Reads a list of endpoints, each with its place.
fn endpoints(root: &Node, key: &str, findings: &mut Findings) -> Vec<(ZenohEndpoint, Place)> {
    let list = root
        .get(&format!("zenoh.{key}"))
        .map_or(&[][..], Node::elements);
    let read = list.iter().filter_map(|element| {
        let text = match element.as_str().map(ZenohEndpoint::from_str) {
            Some(Ok(endpoint)) => return Some((endpoint, element.place.clone()?)),
            Some(Err(error)) => format!("[zenoh]: {error}"),
            None => format!("[zenoh]: `{key}` is a list of texts"),
        };
        let finding = Finding::error("ctos::config::value", text).help(ENDPOINTS_HELP);
        findings.push(finding.at(element.place.clone()));
        None
    });
    read.collect()
}

/// What was asked for, with places, until it is known to fit together.
struct Asked<'a> {
    root: &'a Node,
    mode: ZenohMode,
    connect: Vec<(ZenohEndpoint, Place)>,
    listen: Vec<(ZenohEndpoint, Place)>,
    multicast: Option<String>,
}

fn wrong(text: impl Into<String>, help: &str, place: impl Into<Option<Place>>) -> Finding {
    let finding = Finding::error("ctos::config::zenoh", text);
    finding.help(help).at(place)
}

impl Asked<'_> {
    /// Whom it connects to, and where it listens.
    fn endpoints(&self) -> impl Iterator<Item = &(ZenohEndpoint, Place)> {
        self.connect.iter().chain(&self.listen)
    }

    fn check(&self, findings: &mut Findings) {
        let place = self.root.locate("zenoh");
        if !has_zenoh() {
            let text = "[zenoh] asks for links over zenoh, and this program was built without them";
            let help = "build it with `cargo build --release --features zenoh`, or leave [zenoh] and `same_host = \"zenoh\"` out";
            let finding = Finding::error("ctos::config::no_zenoh", text);
            findings.push(finding.help(help).at(place.clone()));
        }
        let letter = |letter: char| letter.is_ascii_alphanumeric() || "_-.:@".contains(letter);
        if let Some(name) = &self.multicast
            && !name.chars().all(letter)
        {
            let text = format!("[zenoh]: `{name}` is not the name of an interface");
            let help = "write one such as \"lo\" or \"eth0\", or its address";
            findings.push(wrong(text, help, self.root.place_of("zenoh.multicast")));
        }
        if self.mode == ZenohMode::Router && self.listen.is_empty() {
            let text = "[zenoh] with mode = \"router\" does not say where the chassis find it";
            let help = "add listen = [\"tcp/127.0.0.1:7447\"]";
            findings.push(wrong(text, help, place.clone()));
        }
        self.listening(findings);
        if self.mode != ZenohMode::Router && self.connect.is_empty() && self.multicast.is_none() {
            let text = "[zenoh] names neither whom to connect to nor where to look, so nobody would be found";
            findings.push(wrong(text, NOBODY_HELP, place));
        }
        if self.root.tables("security").is_empty() {
            self.without_keys(findings);
        } else {
            self.with_keys(findings);
        }
    }

    /// Every process of an app reads the same configuration, so only one of them could have a port.
    fn listening(&self, findings: &mut Findings) {
        if let (ZenohMode::Client, Some(place)) = (self.mode, self.root.locate("zenoh.listen")) {
            let text = "`listen` has no effect with mode = \"client\"";
            let finding = Finding::warning("ctos::config::no_effect", text);
            findings.push(finding.at(place));
        }
        for (endpoint, place) in &self.listen {
            let fixed = endpoint.port != 0;
            let ip = endpoint.ip();
            let (text, help) = match self.mode {
                _ if ip.is_none() => (
                    "`listen` takes addresses, not names",
                    "write the address of one of its interfaces",
                ),
                ZenohMode::Router if !fixed || ip.is_some_and(|ip| ip.is_unspecified()) => (
                    "the chassis connect to the router at what `listen` says",
                    "write an address that they can reach, and a port",
                ),
                ZenohMode::Peer if fixed => (
                    "only one process of the app could have this port",
                    "write port 0 for a free one, or mode = \"router\"",
                ),
                _ => continue,
            };
            findings.push(wrong(format!("{endpoint}: {text}"), help, place.clone()));
        }
    }

    /// With keys: what the chassis say to each other is closed to everybody, the network itself is not.
    fn with_keys(&self, findings: &mut Findings) {
        let open = |(endpoint, _): &&(ZenohEndpoint, _)| !endpoint.tls && !endpoint.is_loopback();
        for (endpoint, place) in self.listen.iter().filter(open) {
            let text = format!(
                "{endpoint} lets in everybody who can reach it: they can disturb, not read or pose as a chassis"
            );
            let finding = Finding::warning("ctos::config::open_zenoh", text)
                .help("listen only where those are whom you trust");
            findings.push(finding.at(place.clone()));
        }
        for (endpoint, place) in self.endpoints().filter(|(endpoint, _)| endpoint.tls) {
            let text = format!(
                "{endpoint}: zenoh's own TLS connections can end the process when they break (eclipse-zenoh/zenoh#2557)"
            );
            let help = "write tcp/: with [security], chassis speak TLS with each other through it";
            let finding = Finding::warning("ctos::config::zenoh_tls", text).help(help);
            findings.push(finding.at(place.clone()));
        }
    }

    fn without_keys(&self, findings: &mut Findings) {
        let open = |(endpoint, _): &&(ZenohEndpoint, _)| endpoint.tls || !endpoint.is_loopback();
        let open = self.endpoints().filter(open);
        let open = open.map(|(endpoint, place)| (endpoint.to_string(), Some(place.clone())));
        let mut open: Vec<_> = open.collect();
        if let Some(interface) = &self.multicast
            && !interface.parse().map_or(interface == "lo", is_loopback)
        {
            let place = self.root.place_of("zenoh.multicast");
            open.push((format!("multicast on {interface}"), place));
        }
        if open.is_empty() {
            let text = "[zenoh] without keys: every user of this host can join the network and hear and say what they like";
            let finding = Finding::warning("ctos::config::open_zenoh", text).help(KEYS_HELP);
            findings.push(finding.at(self.root.locate("zenoh")));
        }
        for (what, place) in open {
            let text = format!("[zenoh]: {what} needs keys, and the app has none");
            let finding = Finding::error("ctos::config::no_keys", text).help(KEYS_HELP);
            findings.push(finding.at(place));
        }
    }
}
