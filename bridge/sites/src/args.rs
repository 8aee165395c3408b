//! What `[site]` says, and what is wrong with it. Knows no network.

use std::collections::BTreeMap;

use ctos::{
    config::{App, Expander, GeneratedTask, Node, TaskConfig, ZenohEndpoint},
    diagnostic::{Finding, Findings},
    message::CommandInfo,
    registry::Registry,
};
use serde::Deserialize;

use crate::{HANDLER, STAND_IN};

/// The task of the gate.
pub(crate) const GATE: &str = "site";
/// In `allow`, every command that a task takes.
pub(crate) const ALL: &str = "*";
/// The longest that a site may be silent before it counts as cut off, s.
const LONGEST_SILENCE_S: f64 = 3600.0;
/// The least: gates tell twice a second that they are there.
const LEAST_SILENCE_S: f64 = 1.0;

/// What another site may ask, by the names of tasks: the names of their commands.
pub(crate) type Allowed = BTreeMap<String, Vec<String>>;

/// `[site]` without `on`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Args {
    /// What the other sites call this one.
    pub name: String,
    /// Routers; without `listen` the first that answers is used.
    #[serde(default)]
    pub connect: Vec<String>,
    /// Where others connect to the gate: it is a router itself then.
    #[serde(default)]
    pub listen: Vec<String>,
    /// A site that is not heard for so long is cut off.
    #[serde(default = "cut_after_s")]
    pub cut_after_s: f64,
    /// Tasks of other sites, by site and task: their event handlers there.
    #[serde(default)]
    pub reach: BTreeMap<String, BTreeMap<String, String>>,
    /// What other sites may ask here, by site.
    #[serde(default)]
    pub allow: BTreeMap<String, Allowed>,
}

fn cut_after_s() -> f64 {
    2.0
}

impl Args {
    /// After so much silence a site is cut off.
    #[cfg(feature = "zenoh")]
    pub(crate) fn cut_after(&self) -> std::time::Duration {
        std::time::Duration::from_secs_f64(
            self.cut_after_s.clamp(LEAST_SILENCE_S, LONGEST_SILENCE_S),
        )
    }

    /// The sites that are listened for.
    #[cfg(any(test, feature = "zenoh"))]
    pub(crate) fn sites(&self) -> std::collections::BTreeSet<String> {
        let sites = self.reach.keys().chain(self.allow.keys());
        sites.cloned().collect()
    }
}

/// What a stand-in stands for.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(
    not(feature = "zenoh"),
    allow(dead_code, reason = "only a stand-in reads them")
)]
pub(crate) struct StandInArgs {
    /// The site.
    pub site: String,
    /// The task there.
    pub task: String,
    /// Its event handler.
    pub handler: String,
}

/// The commands that the event handler at the other site takes, as this program knows it.
pub(crate) fn commands(task: &TaskConfig, _: &App, registry: &Registry) -> Vec<CommandInfo> {
    let args = task.args.parse::<StandInArgs>().ok();
    let kind = args.and_then(|args| registry.kind(&args.handler));
    kind.map_or_else(Vec::new, |kind| kind.commands().to_vec())
}

/// Turns `[site]` into the gate and the stand-ins.
#[derive(Debug, Clone, Copy, Default)]
pub struct SiteExpander;

impl Expander for SiteExpander {
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask> {
        let Some(place) = table.place().cloned() else {
            return Vec::new();
        };
        let Some(on) = table.get("on").and_then(Node::as_str) else {
            let text = "[site] does not say where its gate runs";
            let help =
                "write on = \"CHASSIS\", best a chassis of its own with restart = \"on-failure\"";
            let finding = Finding::error("ctos::config::missing_key", text);
            findings.push(finding.help(help).at(place));
            return Vec::new();
        };
        let mut tasks = vec![GeneratedTask {
            name: GATE.to_owned(),
            handler: HANDLER.to_owned(),
            on: on.to_owned(),
            args: table.without(&["on"]),
            place,
        }];
        for site in table.get("reach").map(Node::entries).unwrap_or_default() {
            for task in site.value.entries() {
                let (Some(handler), Some(place)) = (task.value.as_str(), task.value.place()) else {
                    // The gate's own arguments tell what is wrong with it.
                    continue;
                };
                tasks.push(GeneratedTask {
                    name: format!("{}@{}", task.key, site.key),
                    handler: STAND_IN.to_owned(),
                    on: on.to_owned(),
                    args: Node::table()
                        .with("site", site.key.as_str())
                        .with("task", task.key.as_str())
                        .with("handler", handler),
                    place: place.clone(),
                });
            }
        }
        tasks
    }
}

/// Whether a site, or a task at one, can be called so: it is a part of a key of the network.
fn is_name(name: &str) -> bool {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-.".contains(letter);
    (1..=64).contains(&name.len()) && name.chars().all(plain)
}

/// Checks what can be checked without the rest of the app.
pub(crate) fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let mut found = Found { task, findings };
    if !cfg!(feature = "zenoh") {
        let finding = Finding::error(
            "bridge::site::not_built",
            "[site] joins this app with others by routers of zenoh, and this program was built without them",
        );
        let help = "build it with `cargo build --release --features zenoh`, or leave [site] out";
        found.push(finding.help(help), "");
        return;
    }
    #[cfg(feature = "zenoh")]
    if let Some(text) = crate::proof::wrong_key(app, &args.name) {
        let help = format!(
            "make one with `ctos keys new keys/{} --role boot`, and name it",
            args.name
        );
        found.push(Finding::error("bridge::site::key", text).help(help), "name");
    }
    let tasks = args.reach.values().flat_map(BTreeMap::keys);
    let sites = args.reach.keys().chain(args.allow.keys());
    for name in sites.chain(tasks).chain([&args.name]) {
        if !is_name(name) {
            let text = format!("`{name}` cannot be the name of a site, or of a task there");
            found.wrong(
                text,
                "names are 1 to 64 letters, digits, `_`, `-` or `.`",
                "",
            );
        }
    }
    for key in ["reach", "allow"] {
        let named = match key {
            "reach" => args.reach.contains_key(&args.name),
            _ => args.allow.contains_key(&args.name),
        };
        if named {
            let text = format!("`{key}` names `{}`, which is this site itself", args.name);
            let help = "tasks of this app have no `@`, and need no permission";
            found.wrong(text, help, &format!("{key}.{}", args.name));
        }
    }
    if !(LEAST_SILENCE_S..=LONGEST_SILENCE_S).contains(&args.cut_after_s) {
        let text = format!("`cut_after_s` is {}", args.cut_after_s);
        found.wrong(text, "give 1 to 3600 s", "cut_after_s");
    }
    if args.connect.is_empty() && args.listen.is_empty() {
        let text = "[site] names neither a router to connect to nor where to listen".to_owned();
        let help = "write connect = [\"tls/HOST:7447\"], or listen, to be a router itself";
        found.wrong(text, help, "");
    }
    for (key, endpoints) in [("connect", &args.connect), ("listen", &args.listen)] {
        for endpoint in endpoints {
            found.endpoint(endpoint, key, app);
        }
    }
}

/// Findings about the gate.
struct Found<'a> {
    task: &'a TaskConfig,
    findings: &'a mut Findings,
}

impl Found<'_> {
    fn push(&mut self, finding: Finding, key: &str) {
        let place = Some(key).filter(|key| !key.is_empty());
        let place = place.and_then(|key| self.task.args.locate(key));
        let place = place.unwrap_or_else(|| self.task.place.clone());
        self.findings.push(finding.at(place));
    }

    fn wrong(&mut self, text: String, help: &str, key: &str) {
        self.push(Finding::error("ctos::config::value", text).help(help), key);
    }

    /// An endpoint is the loopback's, or has the keys of the app.
    fn endpoint(&mut self, text: &str, key: &str, app: &App) {
        let endpoint: ZenohEndpoint = match text.parse() {
            Ok(endpoint) => endpoint,
            Err(error) => {
                return self.wrong(error.to_string(), "for example tls/10.0.0.5:7447", key);
            }
        };
        let ip: Option<std::net::IpAddr> = endpoint.host.parse().ok();
        let loopback = ip.map_or(endpoint.host == "localhost", |ip| {
            ip.to_canonical().is_loopback()
        });
        if endpoint.tls && app.security.is_none() {
            let text = format!("{endpoint} needs keys, and the app has none");
            let help = "make keys with `ctos keys`, and name them under [security]";
            let finding = Finding::error("ctos::config::no_keys", text).help(help);
            self.push(finding, key);
        } else if !endpoint.tls && !loopback {
            let text = format!(
                "{endpoint}: whoever reaches it could ask everything that `allow` permits to any site"
            );
            let help =
                "write tls/HOST:PORT with [security]; or a loopback address, and come by a tunnel";
            let finding = Finding::error("bridge::site::open", text).help(help);
            self.push(finding, key);
        }
    }
}

/// Checks that there are the tasks, commands and handlers that are named.
pub(crate) fn check_app(app: &App, registry: &Registry, findings: &mut Findings) {
    for task in app.tasks.iter().filter(|task| task.handler == HANDLER) {
        // What cannot be read was found before.
        let Ok(args) = task.args.parse::<Args>() else {
            continue;
        };
        let mut found = Found { task, findings };
        for (site, tasks) in &args.reach {
            for (there, handler) in tasks {
                if registry.kind(handler).is_none() {
                    let text = format!(
                        "`{there}@{site}` shall have the event handler `{handler}`, which nobody registered"
                    );
                    let known = registry.kinds().map(ctos::registry::HandlerKind::name);
                    let finding = Finding::error("ctos::config::unknown_handler", text);
                    let key = format!("reach.{site}.{there}");
                    found.push(finding.suggest(handler, known), &key);
                }
            }
        }
        for (site, tasks) in &args.allow {
            for (task, commands) in tasks {
                found.allowed(app, registry, (site, task), commands);
            }
        }
    }
}

impl Found<'_> {
    /// There must be such a task, and it must take the commands.
    fn allowed(
        &mut self,
        app: &App,
        registry: &Registry,
        (site, task): (&str, &str),
        commands: &[String],
    ) {
        let key = format!("allow.{site}.{task}");
        let Some(config) = app.task(task) else {
            let text = format!("site `{site}` may ask `{task}`, and no task is called so");
            let known = app.tasks.iter().map(|task| task.name.as_str());
            let finding = Finding::error("bridge::site::no_task", text);
            return self.push(finding.suggest(task, known), &key);
        };
        if config.handler == HANDLER || config.handler == STAND_IN {
            let text = format!("site `{site}` may ask `{task}`, which leads to other sites");
            let help = "allow what stands in this app; the other site reaches further ones itself";
            let finding = Finding::error("bridge::site::no_task", text);
            return self.push(finding.help(help), &key);
        }
        #[cfg(feature = "zenoh")]
        if forgets(app, registry, task, commands) {
            let text = format!(
                "site `{site}` may send tokens to net `{task}`, which is not durable: what it has taken is lost with its process"
            );
            let help = "write `durable = true` into its arguments";
            let finding = Finding::warning("bridge::site::not_durable", text);
            self.push(finding.help(help), &key);
        }
        for command in commands.iter().filter(|command| *command != ALL) {
            if let Err(finding) = registry.command_of(app, task, command) {
                self.push(finding, &key);
            }
        }
    }
}

/// Whether a net that is to take tokens does not survive its process.
#[cfg(feature = "zenoh")]
fn forgets(app: &App, registry: &Registry, task: &str, commands: &[String]) -> bool {
    use ctos::message::Command as _;
    use pnt::task::{PutOnce, Tokens};

    let takes = |name: &String| [ALL, Tokens::NAME, PutOnce::NAME].contains(&name.as_str());
    let config = app.task(task);
    let durable = |config| pnt::task::settings(config).is_ok_and(|settings| settings.durable);
    commands.iter().any(takes)
        && pnt::task::net_tasks(app, registry)
            .iter()
            .any(|net| net == task)
        && !config.is_some_and(durable)
}

#[cfg(test)]
mod tests {
    use ctos::{
        config::{Selection, load_texts},
        security::{Role, make_key},
    };

    use super::*;

    fn node(text: &str) -> Node {
        let source = ctos::diagnostic::Source::new("site.toml", text);
        let mut findings = Findings::new();
        let node = Node::from_toml(&source, &mut findings);
        assert!(!findings.has_errors());
        node
    }

    #[test]
    fn each_task_that_is_reached_has_a_stand_in_of_its_name_and_site() {
        let table = node(
            "on = \"gate\"\nname = \"south\"\nconnect = [\"tcp/127.0.0.1:7447\"]\n[reach.north]\ncarry = \"pnt.net\"\nd1 = \"sorma.daemon\"\n",
        );
        let mut findings = Findings::new();
        let tasks = SiteExpander.expand(&table, &mut findings);
        assert!(findings.into_sorted().is_empty());
        let names: Vec<_> = tasks
            .iter()
            .map(|task| (task.name.as_str(), task.handler.as_str(), task.on.as_str()))
            .collect();
        let expected = [
            ("site", HANDLER, "gate"),
            ("carry@north", STAND_IN, "gate"),
            ("d1@north", STAND_IN, "gate"),
        ];
        assert_eq!(names, expected);
        let args: StandInArgs = tasks[1].args.parse().unwrap();
        assert_eq!(
            (&*args.site, &*args.task, &*args.handler),
            ("north", "carry", "pnt.net")
        );
        let args: Args = tasks[0].args.parse().unwrap();
        assert_eq!(args.cut_after_s, 2.0);
        assert_eq!(args.sites().into_iter().collect::<Vec<_>>(), ["north"]);
        assert!(args.allow.is_empty(), "nothing is permitted by default");
    }

    #[test]
    fn a_site_without_a_chassis_is_told_what_to_write() {
        let mut findings = Findings::new();
        assert!(
            SiteExpander
                .expand(&node("name = \"south\"\n"), &mut findings)
                .is_empty()
        );
        let found = findings.into_sorted();
        assert_eq!(found[0].code, "ctos::config::missing_key");
    }

    /// The codes of what is wrong with an app of one chassis that is `[site]` with these lines, and somebody's key.
    fn codes(lines: &str, key: Option<&str>) -> Vec<&'static str> {
        let keys = match key {
            Some(_) => "[security]\nkey = \"keys/shown\"\nauthority = \"keys/ca.pem\"\n",
            None => "",
        };
        let text =
            format!("{keys}[chassis.gate]\n[site]\non = \"gate\"\nname = \"north\"\n{lines}");
        let extra: [(&'static str, &dyn Expander); 1] = [("site", &SiteExpander)];
        let folder = tempfile::tempdir().unwrap();
        if let Some(name) = key {
            let made = make_key(&folder.path().join("keys").join(name), Role::Boot).unwrap();
            for end in ["pem", "key"] {
                let shown = folder.path().join("keys/shown").with_extension(end);
                std::fs::rename(made.with_extension(end), shown).unwrap();
            }
        }
        let file = folder.path().join("app.toml");
        std::fs::write(&file, text).unwrap();
        let selection = Selection {
            file,
            ..Selection::default()
        };
        let app = selection.load(&extra).unwrap();
        let mut registry = Registry::new();
        crate::register(&mut registry);
        let found = registry.check(&app).into_sorted();
        found.iter().map(|finding| finding.code).collect()
    }

    #[cfg(feature = "zenoh")]
    #[test]
    fn what_is_open_unknown_or_without_keys_is_found_before_anything_starts() {
        let good = "connect = [\"tcp/127.0.0.1:7447\"]\n";
        assert_eq!(codes(good, None), [""; 0]);
        assert_eq!(codes("", None), ["ctos::config::value"]);
        assert_eq!(
            codes("connect = [\"tcp/10.0.0.5:7447\"]\n", None),
            ["bridge::site::open"]
        );
        let tls = "connect = [\"tls/10.0.0.5:7447\"]\n";
        assert_eq!(codes(tls, None), ["ctos::config::no_keys"]);
        assert_eq!(codes(tls, Some("north")), [""; 0]);
        assert_eq!(codes(tls, Some("south")), ["bridge::site::key"]);
        let with = |more: &str| codes(&format!("{good}{more}"), None);
        assert_eq!(with("cut_after_s = 0.1\n"), ["ctos::config::value"]);
        assert_eq!(
            with("[site.allow.south]\nnobody = [\"*\"]\n"),
            ["bridge::site::no_task"]
        );
        assert_eq!(
            with("[site.allow.south]\nsite = [\"*\"]\n"),
            ["bridge::site::no_task"]
        );
        let handler = with("[site.reach.south]\ncarry = \"no.such\"\n");
        assert_eq!(handler, ["ctos::config::unknown_handler"]);
        let own = with("[site.reach.north]\ncarry = \"bridge.site\"\n");
        assert_eq!(own, ["ctos::config::value"]);
    }

    #[cfg(not(feature = "zenoh"))]
    #[test]
    fn a_program_without_the_network_says_how_to_build_one() {
        assert_eq!(
            codes("connect = [\"tcp/127.0.0.1:7447\"]\n", None),
            ["bridge::site::not_built"]
        );
    }

    #[test]
    fn an_app_without_the_table_knows_nothing_of_sites() {
        let text = "[chassis.desk]\n[task.one]\nhandler = \"none\"\non = \"desk\"\n";
        let app = load_texts(&[("app.toml", text)], &[], &[]).unwrap();
        let mut registry = Registry::new();
        crate::register(&mut registry);
        let found = registry.check(&app).into_sorted();
        assert!(!found.iter().any(|finding| finding.code.contains("site")));
    }
}
