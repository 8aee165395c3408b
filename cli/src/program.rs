//! What configurations can name: every event handler, channel driver, guard, frame source and expander.

use bridge_ros2::BridgeExpander;
use bridge_sites::SiteExpander;
use cli_scott::{panel, services};
use ctos::{
    config::{App, Expander, Selection},
    diagnostic::{Finding, Findings},
    registry::Registry,
};
use fleet::table::{FleetExpander, told_once};
use mcs::{
    control::LawRegistry, driver::DriverRegistry, guard::GuardRegistry, partition::McsExpander,
};
use sorma::{daemon, ipc::Host};
use vss::{catalog::VssExpander, source::FrameSources};

/// Every event handler of the workspace.
#[must_use]
pub fn registry() -> Registry {
    let mut registry = Registry::new();
    let mut drivers = DriverRegistry::new();
    let mut sources = FrameSources::new();
    sim::register(&mut registry, &mut drivers, &mut sources);
    vss::source::kinds::register(&mut sources);
    mcs_remote::register(&mut drivers);
    let (mut laws, mut guards) = (LawRegistry::new(), GuardRegistry::new());
    mcs_hand::register(&mut registry, &mut laws);
    mcs_collision::register(&mut registry, &mut guards);
    mcs_path::register(&mut registry);
    mcs::register(&mut registry, drivers, laws, guards);
    vss::register(&mut registry, sources);
    coordinators::register(&mut registry);
    tracker::register(&mut registry);
    fleet::register(&mut registry);
    checkers_player::register(&mut registry);
    cli_display::register(&mut registry);
    scene_viewers::register(&mut registry);
    bridge_program::register(&mut registry);
    bridge_ros2::register(&mut registry);
    bridge_sites::register(&mut registry);
    panel::register(&mut registry);
    pnt_net::register(&mut registry);
    pnt::store::keep_states(&mut registry);
    // It cannot be wrong: a test reads it.
    let shipped = services::shipped().unwrap_or_default();
    daemon::register(&mut registry, shipped, |cx, sorm| {
        let host = Host::new(cx.app().name.as_str(), cx.chassis().clock().clone());
        services::register(sorm, &host);
    });
    registry
}

/// The top-level tables of a configuration that this program turns into tasks.
pub const EXPANDERS: [(&str, &dyn Expander); 5] = [
    ("bridge", &BridgeExpander),
    ("fleet", &FleetExpander),
    ("mcs", &McsExpander),
    ("site", &SiteExpander),
    ("vss", &VssExpander),
];

/// The JSON schema of a configuration for this program.
#[must_use]
pub fn schema() -> serde_json::Value {
    ctos::config::schema(&EXPANDERS.map(|(table, _)| table))
}

/// Reads an app's configuration.
///
/// # Errors
/// Everything that is wrong with the file, what it includes, the profiles and the overrides.
pub fn app(selection: &Selection) -> Result<App, Findings> {
    selection.load(&EXPANDERS)
}

/// A file that no other file names was named by a person, who stands somewhere.
fn named_by_hand(finding: Finding) -> Finding {
    match finding.place.is_none() && finding.code == "ctos::file::unreadable" {
        true => finding.help("check the path; it is taken from the folder where you are"),
        false => finding,
    }
}

/// Reads an app and checks all of it: configuration, names, handlers, arguments, nets.
///
/// # Errors
/// All findings, when one of them is an error.
pub fn checked(selection: &Selection, registry: &Registry) -> Result<(App, Findings), Findings> {
    match selection.read(&EXPANDERS) {
        (None, found) => {
            let mut named = Findings::new();
            found
                .into_sorted()
                .into_iter()
                .for_each(|one| named.push(named_by_hand(one)));
            Err(named)
        }
        (Some(app), found) if found.has_errors() => {
            Err(told_once(registry.check_beside(&app, found)))
        }
        (Some(mut app), found) => {
            app.warnings = found;
            let findings = told_once(registry.check(&app));
            match findings.has_errors() {
                true => Err(findings),
                false => Ok((app, findings)),
            }
        }
    }
}
