//! Other hosts of an app: `[host.NAME]`, and where each chassis and the boot listen so that those on
//! other hosts reach them. Also `[control]`, where tools reach the app.
//!
//! Knows addresses; who waits at them is not asked here.

use std::net::{Ipv4Addr, SocketAddr};

use super::{
    App,
    app::HostConfig,
    links::{KEYS_HELP, is_loopback},
    node::Node,
};
use crate::diagnostic::{Finding, Findings, Place};

pub(super) fn hosts(root: &Node, findings: &mut Findings) -> Vec<HostConfig> {
    let read = root.tables("host").iter().filter_map(|entry| {
        let name = entry.key.clone();
        let agent: SocketAddr = entry.value.read("agent")?;
        if agent.port() == 0 || agent.ip().is_unspecified() {
            let text =
                format!("nobody can call {agent}, where the agent of host `{name}` should be");
            let finding = Finding::error("ctos::config::value", text)
                .help("write the address and the port at which `ctos agent` says that it listens");
            findings.push(finding.at(entry.value.place_of("agent")));
            return None;
        }
        Some(HostConfig { name, agent })
    });
    read.collect()
}

/// Finds what only the whole app shows to be wrong.
pub(super) fn check(app: &App, findings: &mut Findings) {
    app.hosts_meant(findings);
    app.hosts_used(findings);
    if app.root.tables("security").is_empty() {
        app.hosts_without_keys(findings);
    }
    app.hosts_reachable(findings);
}

impl App {
    fn hosts_meant(&self, findings: &mut Findings) {
        // One that is declared with a mistake has a finding of its own.
        let known = || {
            self.root
                .tables("host")
                .iter()
                .map(|entry| entry.key.as_str())
        };
        for one in &self.chassis {
            if let Some(host) = &one.host
                && !known().any(|name| name == host)
            {
                let text = format!("there is no host `{host}`");
                let finding = Finding::error("ctos::config::unknown_host", text)
                    .help(format!(
                        "declare it: [host.{host}] with agent = \"IP:PORT\""
                    ))
                    .suggest(host, known());
                findings.push(finding.at(one.place_of(&self.root, "host")));
            }
        }
    }

    fn hosts_used(&self, findings: &mut Findings) {
        for (index, host) in self.hosts.iter().enumerate() {
            let same = |other: &&HostConfig| other.agent == host.agent;
            if let Some(other) = self.hosts.iter().take(index).find(same) {
                let text = format!(
                    "hosts `{}` and `{}` have the same agent at {}",
                    other.name, host.name, host.agent
                );
                let finding = Finding::error("ctos::config::same_address", text)
                    .help("one agent is one host: put the chassis of both on one of them");
                findings.push(finding.at(host.agent_place(&self.root)));
            }
            if !self.is_used(host) && !findings.has_errors() {
                let text = format!("no chassis is on host `{}`", host.name);
                let finding = Finding::warning("ctos::config::idle_host", text);
                findings.push(finding.at(self.root.locate(&format!("host.\"{}\"", host.name))));
            }
        }
    }

    /// Without keys nothing may be beyond this host: anybody who can reach it could drive the
    /// robot.
    fn hosts_without_keys(&self, findings: &mut Findings) {
        let mut push = |text: String, help: &str, place: Option<Place>| {
            let text = format!("{text}, and the app has no keys");
            let finding = Finding::error("ctos::config::no_keys", text);
            findings.push(finding.help(help).at(place));
        };
        for host in &self.hosts {
            let (name, agent) = (&host.name, host.agent);
            if !is_loopback(agent.ip()) {
                let text = format!("the agent of host `{name}` is at {agent}");
                push(text, KEYS_HELP, host.agent_place(&self.root));
            }
        }
        let chassis = self.chassis.iter().filter_map(|one| {
            let place = one.place_of(&self.root, "listen");
            Some((format!("chassis `{}`", one.name), one.listen?, Some(place)))
        });
        let place = |path| self.root.place_of(path);
        let boot = self
            .listen
            .map(|at| ("the boot".to_owned(), at, place("app.listen")));
        let control = self
            .control
            .map(|at| ("[control]".to_owned(), at, place("control.listen")));
        for (who, address, place) in chassis.chain(boot).chain(control) {
            if !is_loopback(address.ip()) {
                let text = format!("{who} would listen at {address}, where others can reach it");
                let help = format!("{KEYS_HELP}; or listen at 127.0.0.1");
                push(text, &help, place);
            }
        }
    }

    /// Whether a chassis is on that host.
    #[must_use]
    pub fn is_used(&self, host: &HostConfig) -> bool {
        let mut chassis = self.chassis.iter();
        chassis.any(|one| one.host.as_ref() == Some(&host.name))
    }

    /// Chassis of different hosts call each other: an address that means something on one host only
    /// would leave them waiting.
    fn hosts_reachable(&self, findings: &mut Findings) {
        let used = self.hosts.iter().filter(|host| self.is_used(host));
        let (near, far): (Vec<_>, Vec<_>) = used.partition(|host| is_loopback(host.agent.ip()));
        let Some(first) = far.first() else {
            return;
        };
        let is_local =
            |address: &SocketAddr| is_loopback(address.ip()) || address.ip().is_unspecified();
        let mut push = |text: String, help: &str, place: Option<Place>| {
            let finding = Finding::error("ctos::config::unreachable", text);
            findings.push(finding.help(help).at(place));
        };
        let name = &first.name;
        match self.listen {
            None => push(
                format!(
                    "host `{name}` cannot call back: the app does not say where the boot listens for other hosts"
                ),
                "add [app] listen = \"IP:0\", with the address by which other hosts reach this one; 0 is a free port",
                first.agent_place(&self.root),
            ),
            Some(address) if is_local(&address) => push(
                format!("the boot would listen at {address}, which host `{name}` cannot reach"),
                "write the address by which other hosts reach this one",
                self.root.place_of("app.listen"),
            ),
            Some(_) => {}
        }
        for host in near {
            push(
                format!(
                    "the agent of host `{}` is at the loopback of this one, where host `{name}` cannot reach its chassis",
                    host.name
                ),
                "write the address by which other hosts reach it",
                host.agent_place(&self.root),
            );
        }
        for one in &self.chassis {
            if let Some(listen) = one.listen.filter(is_local) {
                push(
                    format!(
                        "chassis `{}` would listen at {listen}, which other hosts cannot reach",
                        one.name
                    ),
                    "write the address by which other hosts reach it, or leave `listen` out",
                    Some(one.place_of(&self.root, "listen")),
                );
            }
        }
    }

    /// The host that chassis `name` lives on; `None` = that of the boot.
    #[must_use]
    pub fn host_of(&self, name: &str) -> Option<&HostConfig> {
        let chassis = self.chassis.iter().find(|one| one.name == name)?;
        let host = chassis.host.as_ref()?;
        self.hosts.iter().find(|known| known.name == *host)
    }

    /// Whether the app has chassis on other hosts.
    #[must_use]
    pub fn is_spread(&self) -> bool {
        self.chassis.iter().any(|one| one.host.is_some())
    }

    /// Where chassis `name`, or the boot, listens for calls over TCP, if the app says so or needs it.
    #[must_use]
    pub fn listens_at(&self, name: &str) -> Option<SocketAddr> {
        let chassis = self.chassis.iter().find(|one| one.name == name);
        if let Some(listen) = chassis.and_then(|one| one.listen) {
            return Some(listen);
        }
        if !self.is_spread() {
            return None;
        }
        if let Some(host) = self.host_of(name) {
            return Some((host.agent.ip(), 0).into());
        }
        let boot = self.listen.unwrap_or((Ipv4Addr::LOCALHOST, 0).into());
        Some(match chassis {
            // The port is the boot's.
            Some(_) => (boot.ip(), 0).into(),
            None => boot,
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::{App, load_texts};

    const TASK: &str =
        "[task.t]\nhandler = \"h\"\non = \"a\"\n[task.u]\nhandler = \"h\"\non = \"b\"\n";
    const KEYS: &str = "[security]\nkey = \"k/a\"\nauthority = \"k/ca.pem\"\n";

    fn load(more: &str) -> Result<App, String> {
        let text = format!("{more}{TASK}");
        load_texts(&[("app.toml", &text)], &[], &[]).map_err(|found| found.to_string())
    }

    #[track_caller]
    fn refused(more: &str, says: &str, place: &str) {
        let found = load(more).unwrap_err();
        assert!(found.contains(says) && found.contains(place), "{found}");
    }

    #[test]
    fn chassis_of_other_hosts_listen_where_their_agent_is_and_those_here_where_the_app_says() {
        let app = load(&format!(
            "[app]\nlisten = \"10.0.0.1:7400\"\n[host.cage]\nagent = \"10.0.0.2:7410\"\n[chassis.a]\nhost = \"cage\"\n[chassis.b]\n{KEYS}"
        ));
        let app = app.unwrap();
        let at = |name: &str| app.listens_at(name).map(|at| at.to_string());
        assert_eq!(at("a").as_deref(), Some("10.0.0.2:0"));
        assert_eq!(at("b").as_deref(), Some("10.0.0.1:0"));
        assert_eq!(at("boot").as_deref(), Some("10.0.0.1:7400"));
        assert_eq!(
            app.host_of("a").map(|host| host.name.as_str()),
            Some("cage")
        );
        assert!(app.host_of("b").is_none() && app.is_spread());
    }

    #[test]
    fn an_app_of_one_host_listens_as_it_says_and_nowhere_else() {
        let app = load("[chassis.a]\nlisten = \"127.0.0.1:7000\"\n[chassis.b]\n").unwrap();
        assert_eq!(app.listens_at("a").map(|at| at.port()), Some(7000));
        assert!(app.listens_at("b").is_none() && app.listens_at("boot").is_none());
    }

    #[test]
    fn agents_of_this_host_need_neither_keys_nor_addresses() {
        let app =
            load("[host.x]\nagent = \"127.0.0.1:7410\"\n[chassis.a]\nhost = \"x\"\n[chassis.b]\n");
        let app = app.unwrap();
        for name in ["a", "b", "boot"] {
            assert_eq!(
                app.listens_at(name).map(|at| at.to_string()).as_deref(),
                Some("127.0.0.1:0")
            );
        }
    }

    #[test]
    fn what_cannot_work_is_found_with_its_place() {
        let far = "[host.cage]\nagent = \"10.0.0.2:7410\"\n";
        let here = "[app]\nlisten = \"10.0.0.1:0\"\n";
        let both = "[chassis.a]\nhost = \"cage\"\n[chassis.b]\n";
        for (text, says, place) in [
            (
                format!(
                    "{far}[chassis.a]\nhost = \"cagee\"\n[chassis.b]\nhost = \"cage\"\n{here}{KEYS}"
                ),
                "did you mean `cage`",
                "app.toml:4:",
            ),
            (
                "[chassis.a]\nhost = \"x\"\n[chassis.b]\n".to_owned(),
                "declare it: [host.x]",
                "app.toml:2:",
            ),
            (
                format!("{far}{both}{here}"),
                "is at 10.0.0.2:7410, and the app has no keys",
                "app.toml:2:",
            ),
            (
                format!("{far}{both}{KEYS}"),
                "add [app] listen",
                "app.toml:2:",
            ),
            (
                format!("{far}{both}{KEYS}[app]\nlisten = \"127.0.0.1:0\"\n"),
                "which host `cage` cannot reach",
                "app.toml:10:",
            ),
            (
                format!("{far}{both}{KEYS}[app]\nlisten = \"0.0.0.0:0\"\n"),
                "which host `cage` cannot reach",
                "app.toml:10:",
            ),
            (
                format!("{far}{both}listen = \"127.0.0.1:0\"\n{KEYS}{here}"),
                "which other hosts cannot reach",
                "app.toml:6:",
            ),
            (
                format!(
                    "{far}[host.y]\nagent = \"127.0.0.1:7410\"\n[chassis.a]\nhost = \"cage\"\n[chassis.b]\nhost = \"y\"\n{here}{KEYS}"
                ),
                "is at the loopback of this one",
                "app.toml:4:",
            ),
            (
                format!("{far}[host.y]\nagent = \"10.0.0.2:7410\"\n{both}{here}{KEYS}"),
                "have the same agent",
                "app.toml:4:",
            ),
            (
                "[host.x]\nagent = \"10.0.0.2:0\"\n[chassis.a]\nhost = \"x\"\n[chassis.b]\n"
                    .to_owned(),
                "nobody can call",
                "app.toml:2:",
            ),
            (
                "[host.x]\n[chassis.a]\nhost = \"x\"\n[chassis.b]\n".to_owned(),
                "has no `agent`",
                "app.toml:",
            ),
            (
                "[chassis.a]\n[chassis.b]\n[control]\nlisten = \"0.0.0.0:7411\"\n".to_owned(),
                "[control] would listen",
                "app.toml:4:",
            ),
            (
                "[chassis.a]\n[chassis.b]\n[app]\nlisten = \"10.0.0.1:0\"\n".to_owned(),
                "the boot would listen",
                "app.toml:4:",
            ),
        ] {
            refused(&text, says, place);
        }
    }

    #[test]
    fn a_host_without_chassis_is_a_warning() {
        let app = load("[host.x]\nagent = \"127.0.0.1:7410\"\n[chassis.a]\n[chassis.b]\n").unwrap();
        let said = app.warnings.to_string();
        assert!(said.contains("no chassis is on host `x`"), "{said}");
    }

    #[test]
    fn tools_are_let_in_where_control_says() {
        let app =
            load("[chassis.a]\n[chassis.b]\n[control]\nlisten = \"127.0.0.1:7411\"\n").unwrap();
        assert_eq!(app.control.map(|at| at.port()), Some(7411));
    }
}
