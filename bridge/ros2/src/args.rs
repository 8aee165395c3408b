//! What `[bridge.ros2]` says, and what is wrong with it. Knows no network.

use std::collections::BTreeMap;

use ctos::{
    config::{App, Expander, GeneratedTask, Node, TaskConfig, ZenohEndpoint},
    diagnostic::{Finding, Findings},
    registry::Registry,
};
use serde::Deserialize;

use crate::HANDLER;

/// The task that the table makes.
const TASK: &str = "ros2";
/// Domains that rmw implementations take.
const MOST_DOMAIN: u32 = 232;

/// Where `rmw_zenoh` looks for a router.
const ROUTER: &str = "tcp/127.0.0.1:7447";

/// `[bridge.ros2]` without `on`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Args {
    /// Routers that it connects to, the first that answers; not with `listen`.
    pub connect: Option<Vec<String>>,
    /// Where nodes connect to it: it is their router then.
    #[serde(default)]
    pub listen: Vec<String>,
    /// `ROS_DOMAIN_ID`.
    #[serde(default)]
    pub domain: u32,
    /// Stands before all names that do not begin with a slash.
    #[serde(default)]
    pub namespace: String,
    /// The name of the node; that of the app when it is left out.
    pub node: Option<String>,
    /// Whether anything may be ordered.
    #[serde(default)]
    pub allow_control: bool,
    /// Topics; everything that there is to see when it is left out.
    pub publish: Option<BTreeMap<String, Published>>,
    /// Topics that are taken.
    #[serde(default)]
    pub take: BTreeMap<String, Taken>,
    /// Services.
    #[serde(default)]
    pub serve: BTreeMap<String, Served>,
}

/// What a topic tells, and of whom.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Published {
    /// `sensor_msgs/JointState` of these tasks.
    Joints(Vec<String>),
    /// `tf2_msgs/TFMessage` of these tasks.
    Frames(Vec<String>),
    /// `diagnostic_msgs/DiagnosticArray`: what these tasks say, and the bridge.
    Said(Vec<String>),
    /// `sensor_msgs/Image` of this camera.
    Picture(String),
    /// `sensor_msgs/CameraInfo` of this camera.
    Lens(String),
}

impl Published {
    /// The tasks that it names.
    fn tasks(&self) -> &[String] {
        match self {
            Self::Joints(tasks) | Self::Frames(tasks) | Self::Said(tasks) => tasks,
            Self::Picture(_) | Self::Lens(_) => &[],
        }
    }
}

/// A topic of `trajectory_msgs/JointTrajectory` that an arm follows.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Taken {
    /// The client interface of the arm.
    pub task: String,
    /// Fraction of full speed.
    #[serde(default = "slow")]
    pub speed: f64,
}

fn slow() -> f64 {
    0.2
}

/// A service of the type `std_srvs/Trigger`.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Served {
    /// The task that is asked.
    pub task: String,
    /// What it is asked: a command without fields.
    pub command: String,
}

impl Args {
    /// Where it listens, or else connects.
    pub fn endpoints(&self) -> Vec<String> {
        match (&self.listen[..], &self.connect) {
            ([], None) => vec![ROUTER.to_owned()],
            ([], Some(connect)) => connect.clone(),
            (listen, _) => listen.to_vec(),
        }
    }
    /// The full name of a topic or service.
    #[cfg(any(test, feature = "zenoh"))]
    pub fn name(&self, name: &str) -> String {
        if name.starts_with('/') {
            return name.to_owned();
        }
        let space = self.namespace.trim_matches('/');
        match space.is_empty() {
            true => format!("/{name}"),
            false => format!("/{space}/{name}"),
        }
    }
}

/// A text as a part of a ROS name: letters, digits and underscores, not a digit first.
pub(crate) fn plain(text: &str) -> String {
    let plain = |one: char| match one.is_ascii_alphanumeric() {
        true => one,
        false => '_',
    };
    let name: String = text.chars().map(plain).collect();
    match name.chars().next() {
        None => "_".to_owned(),
        Some(first) if first.is_ascii_digit() => format!("_{name}"),
        Some(_) => name,
    }
}

/// Whether ROS takes it as a name of a topic: parts of letters, digits and underscores.
fn is_name(name: &str) -> bool {
    let parts = name.strip_prefix('/').unwrap_or(name).split('/');
    name.len() < 200
        && parts
            .into_iter()
            .all(|part| !part.is_empty() && plain(part) == part)
}

/// Turns `[bridge.ros2]` into a task.
#[derive(Debug, Clone, Copy, Default)]
pub struct BridgeExpander;

/// The table `[bridge]`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bridges {
    #[serde(rename = "ros2")]
    _ros2: serde::de::IgnoredAny,
}

impl Expander for BridgeExpander {
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask> {
        let known = findings.keep(table.parse::<Bridges>()).is_some();
        let Some(ros2) = table.get("ros2").filter(|_| known) else {
            return Vec::new();
        };
        let place = ros2.place().or_else(|| table.place());
        let Some(place) = place.cloned() else {
            return Vec::new();
        };
        let Some(on) = ros2.get("on").and_then(Node::as_str) else {
            let text = "[bridge.ros2] does not say where it runs";
            let help =
                "write on = \"CHASSIS\", best a chassis of its own with restart = \"on-failure\"";
            let finding = Finding::error("ctos::config::missing_key", text);
            findings.push(finding.help(help).at(place));
            return Vec::new();
        };
        vec![GeneratedTask {
            name: TASK.to_owned(),
            handler: HANDLER.to_owned(),
            on: on.to_owned(),
            args: ros2.without(&["on"]),
            place,
        }]
    }
}

/// Checks what can be checked without the rest of the app.
pub(crate) fn check(args: &Args, task: &TaskConfig, app: &App, findings: &mut Findings) {
    let mut found = Found { task, findings };
    if !cfg!(feature = "zenoh") {
        let finding = Finding::error(
            "bridge::ros2::not_built",
            "[bridge.ros2] asks for topics and services of ROS 2, and this program was built without them",
        );
        let help =
            "build it with `cargo build --release --features ros2`, or leave [bridge.ros2] out";
        found.push(finding.help(help), "");
        return;
    }
    if args.domain > MOST_DOMAIN {
        let text = format!("domain {} is above {MOST_DOMAIN}", args.domain);
        found.wrong(text, "write the ROS_DOMAIN_ID of the other nodes", "domain");
    }
    let names = args
        .publish
        .iter()
        .flatten()
        .map(|(name, _)| ("publish", name));
    let names = names.chain(args.take.keys().map(|name| ("take", name)));
    let names = names.chain(args.serve.keys().map(|name| ("serve", name)));
    let own = [("namespace", &args.namespace)].into_iter();
    let own = own.filter(|(_, name)| !name.is_empty());
    for (table, name) in own.chain(names) {
        if !is_name(name) {
            let text = format!("`{name}` is no name that ROS takes");
            let help =
                "write parts of letters, digits and underscores between slashes, no digit first";
            found.wrong(text, help, table);
        }
    }
    if let Some(node) = args.node.as_ref().filter(|node| plain(node) != **node) {
        let text = format!("`{node}` is no name of a node");
        found.wrong(text, "write letters, digits and underscores", "node");
    }
    for (name, taken) in &args.take {
        if !(taken.speed > 0.0 && taken.speed <= 1.0) {
            let text = format!(
                "`{name}`: speed {} is not a fraction of full speed",
                taken.speed
            );
            found.wrong(text, "write a number above 0, at most 1", "take");
        }
    }
    let key = match args.listen.is_empty() {
        true => "connect",
        false => "listen",
    };
    for endpoint in args.endpoints() {
        found.endpoint(&endpoint, key, args, app);
    }
    if args.endpoints().is_empty() {
        let text = "[bridge.ros2] names neither a router to connect to nor where to listen";
        let help = "write connect = [\"tcp/127.0.0.1:7447\"], or listen, to be the router";
        found.wrong(text.to_owned(), help, "connect");
    }
    if args.connect.is_some() && !args.listen.is_empty() {
        let text = "`connect` has no effect with `listen`: the bridge is the router then";
        let finding = Finding::warning("ctos::config::no_effect", text);
        found.push(finding, "connect");
    }
}

/// Findings about one task.
struct Found<'a> {
    task: &'a TaskConfig,
    findings: &'a mut Findings,
}

impl Found<'_> {
    fn push(&mut self, finding: Finding, key: &str) {
        let place = self.task.args.locate(key);
        let place = place.unwrap_or_else(|| self.task.place.clone());
        self.findings.push(finding.at(place));
    }

    fn wrong(&mut self, text: String, help: &str, key: &str) {
        self.push(Finding::error("ctos::config::value", text).help(help), key);
    }

    /// An endpoint may be the loopback's, or has the keys of the app.
    fn endpoint(&mut self, text: &str, key: &str, args: &Args, app: &App) {
        let endpoint: ZenohEndpoint = match text.parse() {
            Ok(endpoint) => endpoint,
            Err(error) => {
                return self.wrong(error.to_string(), "for example tcp/127.0.0.1:7447", key);
            }
        };
        let ip: Option<std::net::IpAddr> = endpoint.host.parse().ok();
        let loopback = ip.map_or(endpoint.host == "localhost", |ip| {
            ip.to_canonical().is_loopback()
        });
        if endpoint.tls && app.security.is_none() {
            let text = format!("{endpoint} needs keys, and the app has none");
            let help = "make keys with `ctos key`, and name them under [security]";
            return self.push(
                Finding::error("ctos::config::no_keys", text).help(help),
                key,
            );
        }
        if !endpoint.tls && !loopback {
            let text = format!(
                "{endpoint}: whoever reaches it would see everything, and could order what is allowed"
            );
            let help = "write tls/HOST:PORT with [security]; or a loopback address, and come by `ssh -L 7447:127.0.0.1:7447 HOST`";
            return self.push(Finding::error("bridge::ros2::open", text).help(help), key);
        }
        if args.allow_control {
            let (who, help) = match endpoint.tls {
                true => (
                    "every holder of a key of this authority, of any role",
                    "give keys only to those who may order that",
                ),
                false => (
                    "every user of this host",
                    "leave `allow_control` out where that is not wanted",
                ),
            };
            let text = format!("{endpoint}: {who} may order what `take` and `serve` name");
            self.push(
                Finding::warning("bridge::ros2::control", text).help(help),
                key,
            );
        }
    }
}

/// Checks that there are the tasks and commands that are named.
pub(crate) fn check_app(app: &App, registry: &Registry, findings: &mut Findings) {
    for task in app.tasks.iter().filter(|task| task.handler == HANDLER) {
        // What cannot be read was found before.
        let Ok(args) = task.args.parse::<Args>() else {
            continue;
        };
        let mut found = Found { task, findings };
        let shows = scene::follow::sources(app, registry);
        for (name, published) in args.publish.iter().flatten() {
            for of in published.tasks().iter().filter(|of| !shows.contains(of)) {
                let text = format!(
                    "`{name}` tells what `{of}` shows, and no task of that name shows anything"
                );
                let known = shows.iter().map(String::as_str);
                let finding = Finding::error("bridge::ros2::no_source", text);
                found.push(finding.suggest(of, known), "publish");
            }
        }
        for (name, taken) in &args.take {
            found.command(app, registry, ("take", name), &taken.task, "move");
        }
        for (name, served) in &args.serve {
            found.command(
                app,
                registry,
                ("serve", name),
                &served.task,
                &served.command,
            );
        }
    }
}

impl Found<'_> {
    /// There must be a task that takes the command; one that is served has no fields.
    fn command(
        &mut self,
        app: &App,
        registry: &Registry,
        (table, name): (&str, &str),
        task: &str,
        command: &str,
    ) {
        let found = app.tasks.iter().find(|one| one.name == task);
        let Some(found) = found else {
            let text = format!("`{name}` asks task `{task}`, and there is none");
            let known = app.tasks.iter().map(|task| task.name.as_str());
            let finding = Finding::error("bridge::ros2::no_task", text);
            return self.push(finding.suggest(task, known), table);
        };
        // An unknown handler has a finding of its own.
        if registry.kind(&found.handler).is_none() {
            return;
        }
        let commands = registry.commands_of(found, app);
        match commands.iter().find(|info| info.name == command) {
            None => {
                let text = format!("`{name}`: task `{task}` takes no command `{command}`");
                let known = commands.iter().map(|command| command.name);
                let finding = Finding::error("bridge::ros2::no_command", text);
                self.push(finding.suggest(command, known), table);
            }
            Some(command) if table == "serve" && command.request.fields() > 0 => {
                let text = format!(
                    "`{name}`: the command `{}` has fields, and a Trigger has none",
                    command.name
                );
                let help = "name a command without fields";
                self.push(
                    Finding::error("bridge::ros2::fields", text).help(help),
                    table,
                );
            }
            Some(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_what_ros_takes_and_others_are_made_so() {
        for name in ["tf", "/tf", "a/b_1", "/robot1/joint_states"] {
            assert!(is_name(name), "{name}");
        }
        for name in [
            "", "/", "a//b", "a/", "1a", "a/1", "a b", "a*", "~/x", "\u{e4}",
        ] {
            assert!(!is_name(name), "{name}");
        }
        for (text, name) in [
            ("left-1", "left_1"),
            ("1", "_1"),
            ("", "_"),
            ("caf\u{e9}", "caf_"),
        ] {
            assert_eq!(plain(text), name);
            assert!(is_name(&plain(text)));
        }
    }

    #[test]
    fn a_name_without_a_slash_stands_in_the_namespace() {
        let node = Node::table().with("namespace", "/cell/");
        let args: Args = node.parse().unwrap();
        assert_eq!(args.name("joint_states"), "/cell/joint_states");
        assert_eq!(args.name("/tf"), "/tf");
        let args: Args = Node::table().parse().unwrap();
        assert_eq!(args.name("joint_states"), "/joint_states");
    }
}
