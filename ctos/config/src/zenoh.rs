//! What `[zenoh]` says: the network by which the chassis of an app find and reach each other beyond the
//! handful of machines that one lists by hand.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    str::FromStr,
};

use super::{
    fields::Fields,
    keys,
    links::{KEYS_HELP, SameHost, is_loopback},
    node::Node,
};
use crate::diagnostic::{Finding, Findings, Place};

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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
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

/// A text that is no endpoint.
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

/// Reads `[zenoh]`.
pub(super) fn zenoh(
    root: &Node,
    same_host: SameHost,
    findings: &mut Findings,
) -> Option<ZenohConfig> {
    let mut fields = Fields::top(root, keys::ZENOH, findings);
    let modes = [
        ("peer", ZenohMode::Peer),
        ("client", ZenohMode::Client),
        ("router", ZenohMode::Router),
    ];
    let mode = fields.choice("mode", &modes);
    let multicast = fields.text("multicast");
    if fields.is_empty() {
        let place = root.locate("app.same_host");
        if let Some(place) = place.filter(|_| same_host == SameHost::Zenoh) {
            let text = "`same_host = \"zenoh\"` joins chassis over a network that is not described";
            let finding = Finding::error("ctos::config::zenoh", text);
            findings.push(finding.help(NOBODY_HELP).at(place));
        }
        return None;
    }
    let connect = endpoints(&mut fields, "connect");
    let listen = endpoints(&mut fields, "listen");
    let asked = Asked {
        place: root.locate("zenoh")?,
        listen_place: root.locate("zenoh.listen"),
        mode,
        connect,
        listen,
        multicast,
    };
    let has_keys = !root.tables("security").is_empty();
    asked.check(has_keys, findings);
    Some(asked.config())
}

/// Reads a list of endpoints, each with its place.
fn endpoints(fields: &mut Fields<'_, '_>, key: &str) -> Vec<(ZenohEndpoint, Place)> {
    let help = "write a list such as [\"tls/10.0.0.5:7447\"]";
    let mut endpoints = Vec::new();
    for element in fields.list(key, help) {
        let parsed = element.as_str().map(str::parse::<ZenohEndpoint>);
        let text = match (parsed, element.place()) {
            (Some(Ok(endpoint)), Some(place)) => {
                endpoints.push((endpoint, place.clone()));
                continue;
            }
            (Some(Err(error)), _) => format!("[zenoh]: {error}"),
            _ => format!("[zenoh]: `{key}` is a list of texts"),
        };
        let finding = Finding::error("ctos::config::value", text).help(help);
        fields.push(finding.at(element.place().cloned()));
    }
    endpoints
}

const NOBODY_HELP: &str = "add [zenoh] with connect = [\"tls/HOST:7447\"] for a router, or mode = \"router\" with listen, or multicast = \"lo\"";

/// What was asked for, with places, until it is known to fit together.
struct Asked<'a> {
    place: Place,
    listen_place: Option<Place>,
    mode: ZenohMode,
    connect: Vec<(ZenohEndpoint, Place)>,
    listen: Vec<(ZenohEndpoint, Place)>,
    multicast: Option<(&'a str, Place)>,
}

fn wrong(text: impl Into<String>, help: &str, place: &Place) -> Finding {
    let finding = Finding::error("ctos::config::zenoh", text);
    finding.help(help).at(place.clone())
}

fn warning(code: &'static str, text: impl Into<String>, help: &str, place: &Place) -> Finding {
    Finding::warning(code, text).help(help).at(place.clone())
}

impl Asked<'_> {
    fn config(self) -> ZenohConfig {
        let endpoints = |list: Vec<(ZenohEndpoint, Place)>| {
            let endpoints = list.into_iter().map(|(endpoint, _)| endpoint);
            endpoints.collect::<Vec<_>>()
        };
        let mut listen = endpoints(self.listen);
        if listen.is_empty() {
            listen.push(ZenohEndpoint {
                tls: false,
                host: Ipv4Addr::LOCALHOST.to_string(),
                port: 0,
            });
        }
        ZenohConfig {
            mode: self.mode,
            connect: endpoints(self.connect),
            listen,
            multicast: self.multicast.map(|(interface, _)| interface.to_owned()),
        }
    }

    /// Whom it connects to, and where it listens.
    fn endpoints(&self) -> impl Iterator<Item = &(ZenohEndpoint, Place)> {
        self.connect.iter().chain(&self.listen)
    }

    fn check(&self, has_keys: bool, findings: &mut Findings) {
        if !has_zenoh() {
            let text = "[zenoh] asks for links over zenoh, and this program was built without them";
            let help = "build it with `cargo build --release --features zenoh`, or leave [zenoh] and `same_host = \"zenoh\"` out";
            let finding = Finding::error("ctos::config::no_zenoh", text);
            findings.push(finding.help(help).at(self.place.clone()));
        }
        let letter = |letter: char| letter.is_ascii_alphanumeric() || "_-.:@".contains(letter);
        if let Some((name, place)) = &self.multicast
            && !name.chars().all(letter)
        {
            let text = format!("[zenoh]: `{name}` is not the name of an interface");
            let help = "write one such as \"lo\" or \"eth0\", or its address";
            findings.push(wrong(text, help, place));
        }
        self.listening(findings);
        if self.mode != ZenohMode::Router && self.connect.is_empty() && self.multicast.is_none() {
            let text = "[zenoh] names neither whom to connect to nor where to look, so nobody would be found";
            findings.push(wrong(text, NOBODY_HELP, &self.place));
        }
        if has_keys {
            self.with_keys(findings);
        } else {
            self.without_keys(findings);
        }
    }

    /// Every process of an app reads the same configuration, so only one of them could have a port.
    fn listening(&self, findings: &mut Findings) {
        if self.mode == ZenohMode::Router && self.listen.is_empty() {
            let text = "[zenoh] with mode = \"router\" does not say where the chassis find it";
            let help = "add listen = [\"tcp/127.0.0.1:7447\"]";
            findings.push(wrong(text, help, &self.place));
        }
        if let (ZenohMode::Client, Some(place)) = (self.mode, &self.listen_place) {
            let text = "`listen` has no effect with mode = \"client\"";
            let finding = Finding::warning("ctos::config::no_effect", text);
            findings.push(finding.at(place.clone()));
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
            findings.push(wrong(format!("{endpoint}: {text}"), help, place));
        }
    }

    /// With keys: what the chassis say to each other is closed to everybody, the network itself is not.
    fn with_keys(&self, findings: &mut Findings) {
        let open = |(endpoint, _): &&(ZenohEndpoint, _)| !endpoint.tls && !endpoint.is_loopback();
        for (endpoint, place) in self.listen.iter().filter(open) {
            let text = format!(
                "{endpoint} lets in everybody who can reach it: they can disturb, not read or pose as a chassis"
            );
            let help = "listen only where those are whom you trust";
            findings.push(warning("ctos::config::open_zenoh", text, help, place));
        }
        for (endpoint, place) in self.endpoints().filter(|(endpoint, _)| endpoint.tls) {
            let text = format!(
                "{endpoint}: zenoh's own TLS connections can end the process when they break (eclipse-zenoh/zenoh#2557)"
            );
            let help = "write tcp/: with [security], chassis speak TLS with each other through it";
            findings.push(warning("ctos::config::zenoh_tls", text, help, place));
        }
    }

    fn without_keys(&self, findings: &mut Findings) {
        let open = |(endpoint, _): &&(ZenohEndpoint, _)| endpoint.tls || !endpoint.is_loopback();
        let open = self.endpoints().filter(open);
        let open = open.map(|(endpoint, place)| (endpoint.to_string(), place));
        let multicast = self.multicast.iter().filter(|(interface, _)| {
            let ip = interface.parse::<IpAddr>();
            !ip.map_or(*interface == "lo", is_loopback)
        });
        let multicast =
            multicast.map(|(interface, place)| (format!("multicast on {interface}"), place));
        let mut open = open.chain(multicast).peekable();
        if open.peek().is_none() {
            let text = "[zenoh] without keys: every user of this host can join the network and hear and say what they like";
            findings.push(warning(
                "ctos::config::open_zenoh",
                text,
                KEYS_HELP,
                &self.place,
            ));
        }
        for (what, place) in open {
            let text = format!("[zenoh]: {what} needs keys, and the app has none");
            let finding = Finding::error("ctos::config::no_keys", text);
            findings.push(finding.help(KEYS_HELP).at(place.clone()));
        }
    }
}
