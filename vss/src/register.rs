//! The event handlers of VSS under the names that the catalog uses.

use std::sync::Arc;

use ctos::{
    config::{Node, TaskConfig},
    diagnostic::{Finding, Findings},
    registry::Registry,
};

use crate::{service, source::FrameSources, spot::SpotOptions, tool, vm, vmm, vsm};

/// Registers every event handler of VSS; Vision Modules take their pictures from `sources`.
pub fn register(registry: &mut Registry, sources: FrameSources) {
    let sources = Arc::new(sources);
    registry
        .handler("vss.vsm", vsm::COMMANDS, vsm::ServicesManager::new)
        .args::<vsm::VsmArgs>()
        .waits_for(vsm::waits_for);
    registry
        .handler("vss.vmm", vmm::COMMANDS, vmm::ModuleManager::new)
        .args::<vmm::VmmArgs>();
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
        .args::<service::SpotFindArgs>();
    registry
        .handler(
            "vss.svc_pair_find",
            service::PAIR_FIND_COMMANDS,
            service::PairFindService::new,
        )
        .args::<service::SpotFindArgs>();
    registry
        .handler(
            "vss.svc_target_find",
            service::TARGET_FIND_COMMANDS,
            service::TargetFindService::new,
        )
        .args::<service::TargetFindArgs>();
    registry
        .handler(
            "vss.svc_disk_find",
            service::DISK_FIND_COMMANDS,
            service::DiskFindService::new,
        )
        .args::<service::DiskFindArgs>();
    registry.handler("vss.svc_calibrate", service::CALIBRATE_COMMANDS, |_| {
        Ok(service::CalibrateService)
    });
}

fn tools(registry: &mut Registry) {
    registry
        .handler("vss.tool_snap", tool::SNAP_COMMANDS, tool::SnapTool::new)
        .args::<tool::PerCameraArgs>();
    registry
        .handler(
            "vss.tool_image_disp",
            tool::IMAGE_DISP_COMMANDS,
            tool::ImageDispTool::new,
        )
        .args::<tool::SharedArgs>();
    registry
        .handler(
            "vss.tool_spot_find",
            tool::SPOT_FIND_COMMANDS,
            tool::SpotFindTool::new,
        )
        .args::<SpotOptions>();
    registry
        .handler(
            "vss.tool_target_find",
            tool::TARGET_FIND_COMMANDS,
            tool::TargetFindTool::new,
        )
        .args::<tool::TargetFindArgs>();
    registry
        .handler(
            "vss.tool_disk_find",
            tool::DISK_FIND_COMMANDS,
            tool::DiskFindTool::new,
        )
        .args::<tool::DiskFindArgs>();
    registry
        .handler(
            "vss.tool_spot_disp",
            tool::SPOT_DISP_COMMANDS,
            tool::SpotDispTool::new,
        )
        .args::<tool::SharedArgs>();
}

fn modules(registry: &mut Registry, sources: &Arc<FrameSources>) {
    let (building, checking) = (sources.clone(), sources.clone());
    registry
        .handler("vss.vm_snap", vm::SNAP_COMMANDS, move |cx| {
            vm::SnapModule::new(cx, &building)
        })
        .keys(&["camera", "source", "args", "watch", "buffer", "whole"])
        .check_in_app(move |task, _, findings| snap_arguments(task, &checking, findings));
    registry
        .handler("vss.vm_laser", vm::LASER_COMMANDS, vm::LaserModule::new)
        .args::<vm::LaserArgs>()
        .check_in_app(vm::driver_of);
    registry.handler("vss.vm_image_disp", vm::IMAGE_DISP_COMMANDS, |_| {
        Ok(vm::ImageDispModule::default())
    });
    registry
        .handler(
            "vss.vm_spot_disp",
            vm::SPOT_DISP_COMMANDS,
            vm::SpotDispModule::new,
        )
        .args::<vm::SpotDispArgs>();
}

fn snap_arguments(task: &TaskConfig, sources: &FrameSources, findings: &mut Findings) {
    let refuse = |text: String, place: Option<&ctos::diagnostic::Place>| {
        let place = place.unwrap_or(&task.place).clone();
        Finding::error("vss::args::camera", text).at(place)
    };
    match vm::snap_args(&task.args) {
        Ok(args) => sources.check(&args.source, &args.camera, &args.own, findings),
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
