//! Makes the tasks of the Vision Services System out of the list of Services that an app uses: the table `[vss]` of
//! its configuration against the master configuration `catalog.toml` (CIRSSE report 108, section 5).
//!
//! Tasks are called `vsm`, `vmm`, `svc` + Service, as their Tool, as their Vision Module; Vision Modules of a camera
//! have its name behind a dot: `vmSnap.left`.

use std::collections::{BTreeMap, BTreeSet};

use ctos::{
    config::{Expander, GeneratedTask, Node, Value},
    diagnostic::{Finding, Findings, Place, Source},
};
use serde::Deserialize;

/// The master configuration.
const CATALOG: &str = include_str!("catalog.toml");
/// Task of the Services Manager.
pub const VSM: &str = "vsm";
/// Task of the Vision Module Manager.
pub const VMM: &str = "vmm";
/// The Vision Module of laser scanners.
const SCANNER: &str = "vmLaser";

/// Task of the Vision Module of a laser scanner.
#[must_use]
pub fn scanner_task(scanner: &str) -> String {
    format!("{SCANNER}.{scanner}")
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Catalog {
    service: BTreeMap<String, ServiceEntry>,
    tool: BTreeMap<String, ToolEntry>,
    vm: BTreeMap<String, VmEntry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ServiceEntry {
    handler: String,
    command: String,
    #[serde(default)]
    tools: BTreeMap<String, String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ToolEntry {
    handler: String,
    vm: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct VmEntry {
    handler: String,
    hardware: String,
    #[serde(default)]
    per_camera: bool,
    #[serde(default)]
    per_scanner: bool,
}

/// The table `[vss]` of an app.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct VssTable {
    /// Where its tasks run: `CHASSIS` or `CHASSIS/PROCESSOR`.
    on: String,
    /// The Services that the app uses.
    services: Vec<String>,
    /// The cameras.
    #[serde(default)]
    cameras: BTreeMap<String, CameraTable>,
    /// The laser scanners.
    #[serde(default)]
    scanners: BTreeMap<String, ScannerTable>,
    /// Tasks that run somewhere else: task to `CHASSIS` or `CHASSIS/PROCESSOR`.
    #[serde(default)]
    place: BTreeMap<String, String>,
    /// Event handlers in place of the catalog's own, which take the same commands: task to handler.
    #[serde(default)]
    handlers: BTreeMap<String, String>,
    /// Arguments for tasks that take some: task to table.
    #[serde(default, rename = "args")]
    _args: BTreeMap<String, serde::de::IgnoredAny>,
    /// How long a Tool may hold hardware that others wait for, s.
    hold_limit_s: Option<f64>,
}

/// One camera of the table. Its source reads `args` itself, its Vision Module the rest.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    #[serde(rename = "source")]
    _source: String,
    #[serde(default, rename = "args")]
    _args: serde::de::IgnoredAny,
    #[serde(default, rename = "watch")]
    _watch: serde::de::IgnoredAny,
    #[serde(default, rename = "buffer")]
    _buffer: serde::de::IgnoredAny,
}

/// One laser scanner of the table. Its Vision Module reads it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScannerTable {
    #[serde(rename = "task")]
    _task: String,
}

/// Turns `[vss]` into tasks.
#[derive(Debug, Clone, Copy, Default)]
pub struct VssExpander;

impl Expander for VssExpander {
    fn expand(&self, table: &Node, findings: &mut Findings) -> Vec<GeneratedTask> {
        let Some(catalog) = catalog(findings) else {
            return Vec::new();
        };
        let Some(parsed) = findings.keep(table.parse::<VssTable>()) else {
            return Vec::new();
        };
        Expansion {
            catalog: &catalog,
            table,
            parsed: &parsed,
            findings,
            tasks: Vec::new(),
        }
        .run()
    }
}

fn catalog(findings: &mut Findings) -> Option<Catalog> {
    let source = Source::new("the catalog of vision services", CATALOG);
    let node = Node::from_toml(&source, findings);
    findings.keep(node.parse())
}

struct Expansion<'a> {
    catalog: &'a Catalog,
    table: &'a Node,
    parsed: &'a VssTable,
    findings: &'a mut Findings,
    tasks: Vec<GeneratedTask>,
}

impl<'a> Expansion<'a> {
    fn run(mut self) -> Vec<GeneratedTask> {
        let services = self.services();
        // Everything that the catalog names in itself exists; a test sees to that.
        let tools = services.values().flat_map(|service| service.tools.values());
        let tools: BTreeSet<&str> = tools.map(String::as_str).collect();
        let vms = tools
            .iter()
            .filter_map(|tool| self.catalog.tool.get(*tool)?.vm.as_deref());
        let own = self.catalog.vm.iter().filter(|(_, vm)| vm.per_scanner);
        let own = own.filter(|_| !self.parsed.scanners.is_empty());
        let vms: BTreeSet<&str> = vms.chain(own.map(|(vm, _)| vm.as_str())).collect();
        self.managers(&services, &vms);
        for (name, service) in &services {
            self.service(name, service);
        }
        for tool in tools {
            self.tool(tool);
        }
        for vm in vms {
            self.modules(vm);
        }
        self.check_task_names("place");
        self.check_task_names("handlers");
        self.check_task_names("args");
        self.tasks
    }

    /// The Services that the app names and the catalog has.
    fn services(&mut self) -> BTreeMap<&'a str, &'a ServiceEntry> {
        let mut found = BTreeMap::new();
        for (index, name) in self.parsed.services.iter().enumerate() {
            let place = self.table.locate(&format!("services.{index}"));
            match self.catalog.service.get_key_value(name) {
                Some((key, entry)) => {
                    if found.insert(key.as_str(), entry).is_some() {
                        let text = format!("the Service `{name}` is named twice");
                        self.report(Finding::error("vss::services::twice", text), place);
                    }
                }
                None => {
                    let text = format!("there is no vision Service `{name}`");
                    let known = self.catalog.service.keys().map(String::as_str);
                    let finding = Finding::error("vss::services::unknown", text);
                    self.report(finding.suggest(name, known), place);
                }
            }
        }
        if self.parsed.services.is_empty() {
            let finding = Finding::error("vss::services::none", "no vision Service is named")
                .help("name those that the app uses, for example services = [\"SpotFind\"]");
            self.report(finding, self.table.locate("services"));
        }
        found
    }

    /// The tasks of a Vision Module, with the hardware each drives and, if it has one, its camera or scanner.
    fn tasks_of(&self, vm: &str, entry: &VmEntry) -> Vec<(String, String, Option<&'a str>)> {
        let one = |name: &'a String| {
            let hardware = format!("{} {name}", entry.hardware);
            (format!("{vm}.{name}"), hardware, Some(name.as_str()))
        };
        if entry.per_camera {
            self.parsed.cameras.keys().map(one).collect()
        } else if entry.per_scanner {
            self.parsed.scanners.keys().map(one).collect()
        } else {
            vec![(vm.to_owned(), entry.hardware.clone(), None)]
        }
    }

    fn managers(&mut self, services: &BTreeMap<&str, &ServiceEntry>, vms: &BTreeSet<&str>) {
        let routes = services
            .iter()
            .fold(Node::table(), |routes, (name, service)| {
                routes.with(&service.command, format!("svc{name}"))
            });
        let mut hardware = Node::table();
        let mut tasks: Vec<Node> = Vec::new();
        for (vm, entry) in self
            .catalog
            .vm
            .iter()
            .filter(|(vm, _)| vms.contains(vm.as_str()))
        {
            if entry.per_camera && self.parsed.cameras.is_empty() {
                let text = format!("`{vm}` needs a camera, and the app has none");
                let finding = Finding::error("vss::cameras::none", text)
                    .help("add [vss.cameras.NAME] with source = \"...\"");
                self.report(finding, None);
            }
            for (task, drives, _) in self.tasks_of(vm, entry) {
                tasks.push(task.as_str().into());
                hardware = hardware.with(task, drives);
            }
        }
        self.add(
            VSM,
            "vss.vsm",
            Node::table().with("routes", routes).with("vms", tasks),
        );
        if !vms.is_empty() {
            let args = Node::table().with("hardware", hardware);
            let limit = self.parsed.hold_limit_s;
            let args = limit
                .into_iter()
                .fold(args, |args, limit| args.with("hold_limit_s", limit));
            self.add(VMM, "vss.vmm", args);
        }
    }

    fn service(&mut self, name: &str, service: &ServiceEntry) {
        let tools = service.tools.iter();
        let args = tools.fold(Node::table(), |args, (role, tool)| {
            args.with(role, tool.as_str())
        });
        self.add(&format!("svc{name}"), &service.handler, args);
    }

    fn tool(&mut self, name: &str) {
        let Some(tool) = self.catalog.tool.get(name) else {
            return;
        };
        let mut args = Node::table();
        if let Some(vm) = &tool.vm
            && let Some(entry) = self.catalog.vm.get(vm)
        {
            args = args.with("vmm", VMM);
            args = if entry.per_camera {
                let tasks = self.tasks_of(vm, entry).into_iter();
                let vms = tasks.fold(Node::table(), |vms, (task, _, camera)| {
                    vms.with(camera.unwrap_or_default(), task)
                });
                args.with("vms", vms)
            } else {
                args.with("vm", vm.as_str())
            };
        }
        self.add(name, &tool.handler, args);
    }

    fn modules(&mut self, vm: &str) {
        let Some(entry) = self.catalog.vm.get(vm) else {
            return;
        };
        let (tables, key) = match entry.per_scanner {
            true => ("scanners", "laser"),
            false => ("cameras", "camera"),
        };
        for (task, _, name) in self.tasks_of(vm, entry) {
            // The table of camera or scanner stays, so that findings point into it.
            let own = name.and_then(|name| self.table.get(tables)?.entry(name));
            let args = own.map_or_else(Node::table, |entry| entry.value.clone());
            let args = name
                .into_iter()
                .fold(args, |args, name| args.with(key, name));
            // A Tool of somebody else's may be a program that fetches no pixels from a buffer.
            let whole = entry.per_camera && !self.parsed.handlers.is_empty();
            let args = if whole {
                args.with("whole", true)
            } else {
                args
            };
            self.add(&task, &entry.handler, args);
        }
    }

    /// What the app says for a task with what the catalog says for it; they may not contradict each other.
    fn layered(&mut self, name: &str, generated: Node) -> Node {
        let table = self.table;
        let Some(own) = table.get("args").and_then(|all| all.entry(name)) else {
            return generated;
        };
        let mut args = own.value.clone();
        if !matches!(args.value(), Value::Table(_)) {
            let text = format!("the arguments of `{name}` are {}, not a table", args.kind());
            self.report(
                Finding::error("vss::args::no_table", text),
                args.place().cloned(),
            );
            return generated;
        }
        for entry in generated.entries() {
            if let Some(taken) = args.entry(&entry.key) {
                let text = format!("`{}` of `{name}` is set by the catalog", entry.key);
                let finding = Finding::error("vss::args::taken", text).help("leave it out");
                self.report(finding, taken.key_place.clone());
            }
            args = args.with(&entry.key, entry.value.clone());
        }
        args
    }

    /// Adds a task where `place` or `on` says.
    fn add(&mut self, name: &str, handler: &str, args: Node) {
        let args = self.layered(name, args);
        let on = self.parsed.place.get(name).unwrap_or(&self.parsed.on);
        let written = self
            .table
            .get("place")
            .and_then(|places| places.entry(name));
        let place = match written {
            Some(entry) => entry.value.place().cloned(),
            None => self.table.get("on").and_then(|on| on.place().cloned()),
        };
        let place = place.or_else(|| self.table.place().cloned());
        self.tasks.push(GeneratedTask {
            name: name.to_owned(),
            handler: self
                .parsed
                .handlers
                .get(name)
                .map_or(handler, String::as_str)
                .to_owned(),
            on: on.clone(),
            args,
            // Nodes from a file always have a place.
            place: place.unwrap_or_else(|| Source::new("[vss]", "").at(0..0)),
        });
    }

    /// Every task named under `key` must be one that was made.
    fn check_task_names(&mut self, key: &str) {
        let table = self.table;
        for entry in table.get(key).map_or(&[][..], Node::entries) {
            if !self.tasks.iter().any(|task| task.name == entry.key) {
                let text = format!("the services of this app have no task `{}`", entry.key);
                let known: Vec<&str> = self.tasks.iter().map(|task| task.name.as_str()).collect();
                let finding = Finding::error("vss::task::unknown", text).suggest(&entry.key, known);
                self.report(finding, entry.key_place.clone());
            }
        }
    }

    fn report(&mut self, finding: Finding, place: Option<Place>) {
        let place = place.or_else(|| self.table.place().cloned());
        self.findings.push(match place {
            Some(place) => finding.at(place),
            None => finding,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const APP: &str = r#"
on = "cage_vision/main"
services = ["SpotFind", "Calibrate"]
place = { toolSpotFind = "cage_vision/compute" }
[cameras.left]
source = "test.camera"
args = { seed = 3 }
[cameras.right]
source = "test.camera"
[args.toolSpotFind]
max_sigma_px = 4.0
"#;

    fn expand(text: &str) -> (Vec<GeneratedTask>, Vec<String>) {
        let mut findings = Findings::new();
        let node = Node::from_toml(&Source::new("app.toml", text), &mut findings);
        let tasks = VssExpander.expand(&node, &mut findings);
        (tasks, findings.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn the_catalog_is_closed() {
        let mut findings = Findings::new();
        let catalog = catalog(&mut findings).unwrap();
        assert!(findings.is_empty(), "{findings}");
        for tool in catalog
            .service
            .values()
            .flat_map(|service| service.tools.values())
        {
            let tool = &catalog.tool[tool];
            assert!(tool.vm.iter().all(|vm| catalog.vm.contains_key(vm)));
        }
    }

    #[test]
    fn a_scanner_is_a_vision_module_with_hardware_of_its_own() {
        let (tasks, findings) = expand(&format!("{APP}[scanners.roof]\ntask = 'mirrors'\n"));
        assert!(findings.is_empty(), "{findings:?}");
        let of = |name: &str| tasks.iter().find(|task| task.name == name).unwrap();
        let vm = of("vmLaser.roof");
        assert_eq!(vm.handler, "vss.vm_laser");
        assert_eq!(vm.args.get("task").unwrap().as_str(), Some("mirrors"));
        assert_eq!(vm.args.get("laser").unwrap().as_str(), Some("roof"));
        let hardware = of("vmm").args.get("hardware").unwrap().clone();
        let drives = hardware.entry("vmLaser.roof").unwrap().value.as_str();
        assert_eq!(drives, Some("laser roof"));
        let (_, findings) = expand(&format!("{APP}[scanners.roof]\ndriver = 'mirrors'\n"));
        assert!(findings[0].contains("driver"), "{findings:?}");
    }

    #[test]
    fn the_list_of_services_makes_the_tasks() {
        let (tasks, findings) = expand(APP);
        assert!(findings.is_empty(), "{findings:?}");
        let names: Vec<&str> = tasks.iter().map(|task| task.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "vsm",
                "vmm",
                "svcCalibrate",
                "svcSpotFind",
                "toolImageDisp",
                "toolSnap",
                "toolSpotDisp",
                "toolSpotFind",
                "vmImageDisp",
                "vmSnap.left",
                "vmSnap.right",
                "vmSpotDisp"
            ]
        );
        let of = |name: &str| tasks.iter().find(|task| task.name == name).unwrap();
        assert_eq!(
            of("vsm").args.get("routes.spot_find").unwrap().as_str(),
            Some("svcSpotFind")
        );
        assert_eq!(
            of("toolSnap").args.get("vms.right").unwrap().as_str(),
            Some("vmSnap.right")
        );
        assert_eq!(
            of("vmSnap.left")
                .args
                .get("args.seed")
                .unwrap()
                .as_integer(),
            Some(3)
        );
        assert_eq!(of("toolSpotFind").on, "cage_vision/compute");
        assert_eq!(
            of("toolSpotFind")
                .args
                .get("max_sigma_px")
                .unwrap()
                .as_f64(),
            Some(4.0)
        );
        assert_eq!(of("toolSnap").on, "cage_vision/main");
    }

    #[test]
    fn only_what_the_services_need_is_loaded() {
        let (tasks, findings) = expand("on = \"a\"\nservices = [\"Calibrate\"]\n");
        assert!(findings.is_empty());
        let names: Vec<&str> = tasks.iter().map(|task| task.name.as_str()).collect();
        assert_eq!(names, ["vsm", "svcCalibrate"]);
    }

    #[test]
    fn what_is_wrong_is_said_where_it_stands() {
        let first = |from: &str, to: &str| {
            expand(&APP.replace(from, to))
                .1
                .first()
                .cloned()
                .unwrap_or_default()
        };
        assert_eq!(
            first("\"SpotFind\"", "\"SpotFnid\""),
            "app.toml:3:13: error: there is no vision Service `SpotFnid` (did you mean `SpotFind`?)"
        );
        assert_eq!(
            first("\"Calibrate\"", "\"SpotFind\""),
            "app.toml:3:25: error: the Service `SpotFind` is named twice"
        );
        assert_eq!(
            first("[args.toolSpotFind]", "[args.toolSpotFnd]"),
            "app.toml:10:7: error: the services of this app have no task `toolSpotFnd` (did you mean `toolSpotFind`?)"
        );
        assert_eq!(
            first("max_sigma_px = 4.0", "[args.toolSnap]\nvmm = \"x\""),
            "app.toml:12:1: error: `vmm` of `toolSnap` is set by the catalog (leave it out)"
        );
        let unknown = first("[cameras.right]", "[cameras.right]\nsuorce = 1");
        assert!(unknown.starts_with("app.toml:9:1: error:"), "{unknown}");
        let none = expand("on = \"a\"\nservices = [\"SpotFind\"]\n").1;
        assert!(none[0].contains("needs a camera"), "{none:?}");
    }
}
