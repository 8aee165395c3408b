//! The event handlers of VSS under the names that the catalog uses.

use std::sync::Arc;

use ctos::{
    config::{Node, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
};
use serde::de::DeserializeOwned;

use crate::{service, source::FrameSources, spot::SpotOptions, tool, vm, vmm, vsm};

/// Registers every event handler of VSS; Vision Modules take their pictures from `sources`.
pub fn register(registry: &mut Registry, sources: FrameSources) {
    let sources = Arc::new(sources);
    registry
        .handler("vss.vsm", vsm::COMMANDS, vsm::ServicesManager::new)
        .check(arguments::<vsm::VsmArgs>)
        .waits_for(vsm::waits_for);
    registry
        .handler("vss.vmm", vmm::COMMANDS, vmm::ModuleManager::new)
        .check(arguments::<vmm::VmmArgs>);
    services(registry);
    tools(registry);
    modules(registry, &sources);
}

fn services(registry: &mut Registry) {
    registry
        .handler(
            "vss.svc_spot_find",
            service::SPOT_FIND_COMMANDS,
            service::SpotFindService::new,
        )
        .check(arguments::<service::SpotFindArgs>);
    registry
        .handler("vss.svc_calibrate", service::CALIBRATE_COMMANDS, |_| {
            Ok(service::CalibrateService)
        })
        .check(no_arguments);
}

fn tools(registry: &mut Registry) {
    registry
        .handler("vss.tool_snap", tool::SNAP_COMMANDS, tool::SnapTool::new)
        .check(arguments::<tool::PerCameraArgs>);
    registry
        .handler(
            "vss.tool_image_disp",
            tool::IMAGE_DISP_COMMANDS,
            tool::ImageDispTool::new,
        )
        .check(arguments::<tool::SharedArgs>);
    registry
        .handler(
            "vss.tool_spot_find",
            tool::SPOT_FIND_COMMANDS,
            tool::SpotFindTool::new,
        )
        .check(arguments::<SpotOptions>);
    registry
        .handler(
            "vss.tool_spot_disp",
            tool::SPOT_DISP_COMMANDS,
            tool::SpotDispTool::new,
        )
        .check(arguments::<tool::SharedArgs>);
}

fn modules(registry: &mut Registry, sources: &Arc<FrameSources>) {
    let (building, checking) = (sources.clone(), sources.clone());
    registry
        .handler("vss.vm_snap", vm::SNAP_COMMANDS, move |cx| {
            vm::SnapModule::new(cx, &building)
        })
        .check(move |task, findings| snap_arguments(task, &checking, findings));
    registry
        .handler("vss.vm_image_disp", vm::IMAGE_DISP_COMMANDS, |_| {
            Ok(vm::ImageDispModule)
        })
        .check(no_arguments);
    registry
        .handler(
            "vss.vm_spot_disp",
            vm::SPOT_DISP_COMMANDS,
            vm::SpotDispModule::new,
        )
        .check(arguments::<vm::SpotDispArgs>);
}

/// The arguments read as a `T`.
fn arguments<T: DeserializeOwned>(task: &TaskConfig, findings: &mut Findings) {
    findings.keep(task.args.parse::<T>());
}

fn no_arguments(task: &TaskConfig, findings: &mut Findings) {
    for entry in task.args.entries() {
        let text = format!("`{}` takes no arguments, so no `{}`", task.name, entry.key);
        let place = entry
            .key_place
            .clone()
            .unwrap_or_else(|| task.place.clone());
        findings.push(Finding::error("vss::args::none", text).at(place));
    }
}

fn snap_arguments(task: &TaskConfig, sources: &FrameSources, findings: &mut Findings) {
    let refuse = |text: String, place: Option<&ctos::diagnostic::Place>| {
        let place = place.unwrap_or(&task.place).clone();
        Finding::error("vss::args::camera", text).at(place)
    };
    for entry in task.args.entries() {
        if !["camera", "source", "args"].contains(&entry.key.as_str()) {
            let text = format!("`{}` takes no `{}`", task.name, entry.key);
            let finding = refuse(text, entry.key_place.as_ref());
            findings.push(finding.suggest(&entry.key, ["camera", "source", "args"]));
        }
    }
    match vm::snap_args(&task.args) {
        Ok((camera, source, own)) => sources.check(&source, &camera, &own, findings),
        Err(error) => findings.push(refuse(error.to_string(), task.args.place())),
    }
    if let Some(own) = task
        .args
        .get("args")
        .filter(|own| !matches!(own.value(), ctos::config::Value::Table(_)))
    {
        let text = format!(
            "`args` of `{}` is {}, not a table",
            task.name,
            Node::kind(own)
        );
        findings.push(refuse(text, own.place()));
    }
}
