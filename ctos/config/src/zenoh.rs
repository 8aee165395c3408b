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
    let security = root.entry("security").map(|entry| &entry.value);
    let mut asked = Asked {
        place: root.locate("zenoh")?,
        listen_place: root.locate("zenoh.listen"),
        mode,
        connect,
        listen,
        multicast,
        keys: security.is_some_and(|security| !security.entries().is_empty()),
        findings,
    };
    asked.check();
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
struct Asked<'a, 'f> {
    place: Place,
    listen_place: Option<Place>,
    mode: ZenohMode,
    connect: Vec<(ZenohEndpoint, Place)>,
    listen: Vec<(ZenohEndpoint, Place)>,
    multicast: Option<(&'a str, Place)>,
    keys: bool,
    findings: &'f mut Findings,
}

impl Asked<'_, '_> {
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

    fn error(&mut self, text: impl Into<String>, help: &str, place: &Place) {
        let finding = Finding::error("ctos::config::zenoh", text.into());
        self.findings.push(finding.help(help).at(place.clone()));
    }

    fn check(&mut self) {
        if !has_zenoh() {
            let finding = Finding::error(
                "ctos::config::no_zenoh",
                "[zenoh] asks for links over zenoh, and this program was built without them",
            );
            let help = "build it with `cargo build --release --features zenoh`, or leave [zenoh] and `same_host = \"zenoh\"` out";
            self.findings
                .push(finding.help(help).at(self.place.clone()));
        }
        self.interface();
        self.listening();
        let nobody =
            self.mode != ZenohMode::Router && self.connect.is_empty() && self.multicast.is_none();
        if nobody {
            let place = self.place.clone();
            let text = "[zenoh] names neither whom to connect to nor where to look, so nobody would be found";
            self.error(text, NOBODY_HELP, &place);
        }
        if self.keys {
            self.with_keys();
        } else {
            self.without_keys();
        }
    }

    fn interface(&mut self) {
        let Some((name, place)) = self.multicast.clone() else {
            return;
        };
        let letter = |letter: char| letter.is_ascii_alphanumeric() || "_-.:@".contains(letter);
        if !name.chars().all(letter) {
            let text = format!("[zenoh]: `{name}` is not the name of an interface");
            self.error(
                text,
                "write one such as \"lo\" or \"eth0\", or its address",
                &place,
            );
        }
    }

    /// Every process of an app reads the same configuration, so only one of them could have a port.
    fn listening(&mut self) {
        let listen = self.listen.clone();
        if self.mode == ZenohMode::Router && listen.is_empty() {
            let text = "[zenoh] with mode = \"router\" does not say where the chassis find it";
            let place = self.place.clone();
            self.error(text, "add listen = [\"tcp/127.0.0.1:7447\"]", &place);
        }
        if let (ZenohMode::Client, Some(place)) = (self.mode, self.listen_place.clone()) {
            let finding = Finding::warning(
                "ctos::config::no_effect",
                "`listen` has no effect with mode = \"client\"",
            );
            self.findings.push(finding.at(place));
        }
        for (endpoint, place) in &listen {
            let fixed = endpoint.port != 0;
            let ip = endpoint.ip();
            match self.mode {
                _ if ip.is_none() => {
                    let text = format!("{endpoint}: `listen` takes addresses, not names");
                    self.error(text, "write the address of one of its interfaces", place);
                }
                ZenohMode::Router if !fixed || ip.is_some_and(|ip| ip.is_unspecified()) => {
                    let text = format!(
                        "{endpoint}: the chassis connect to the router at what `listen` says"
                    );
                    let help = "write an address that they can reach, and a port";
                    self.error(text, help, place);
                }
                ZenohMode::Peer if fixed => {
                    let text =
                        format!("{endpoint}: only one process of the app could have this port");
                    let help = "write port 0 for a free one, or mode = \"router\"";
                    self.error(text, help, place);
                }
                _ => {}
            }
        }
    }

    /// With keys: what the chassis say to each other is closed to everybody, the network itself is not.
    fn with_keys(&mut self) {
        for (endpoint, place) in self.listen.clone() {
            if !endpoint.tls && !endpoint.is_loopback() {
                let text = format!(
                    "{endpoint} lets in everybody who can reach it: they can disturb, not read or pose as a chassis"
                );
                let finding = Finding::warning("ctos::config::open_zenoh", text);
                let help = "listen only where those are whom you trust";
                self.findings.push(finding.help(help).at(place));
            }
        }
        let endpoints = self.connect.iter().chain(&self.listen);
        let unsound: Vec<_> = endpoints
            .filter(|(endpoint, _)| endpoint.tls)
            .cloned()
            .collect();
        for (endpoint, place) in unsound {
            let text = format!(
                "{endpoint}: zenoh's own TLS connections can end the process when they break (eclipse-zenoh/zenoh#2557)"
            );
            let finding = Finding::warning("ctos::config::zenoh_tls", text);
            let help = "write tcp/: with [security], chassis speak TLS with each other through it";
            self.findings.push(finding.help(help).at(place));
        }
    }

    fn without_keys(&mut self) {
        let endpoints = self.connect.iter().chain(&self.listen);
        let mut open: Vec<(String, Place)> = endpoints
            .filter(|(endpoint, _)| endpoint.tls || !endpoint.is_loopback())
            .map(|(endpoint, place)| (endpoint.to_string(), place.clone()))
            .collect();
        if let Some((interface, place)) = &self.multicast {
            let ip = interface.parse::<IpAddr>();
            if !ip.map_or(*interface == "lo", is_loopback) {
                open.push((format!("multicast on {interface}"), place.clone()));
            }
        }
        if open.is_empty() {
            let finding = Finding::warning(
                "ctos::config::open_zenoh",
                "[zenoh] without keys: every user of this host can join the network and hear and say what they like",
            );
            self.findings
                .push(finding.help(KEYS_HELP).at(self.place.clone()));
        }
        for (what, place) in open {
            let text = format!("[zenoh]: {what} needs keys, and the app has none");
            let finding = Finding::error("ctos::config::no_keys", text);
            self.findings.push(finding.help(KEYS_HELP).at(place));
        }
    }
}
