//! `ctos agent`: waits on a host for boots.

use std::{net::SocketAddr, path::PathBuf, sync::Arc};

use clap::Args;
use ctos::{
    registry::Registry,
    remote::{AgentError, AgentEvent, AgentObserver, AgentSetup, HostAgent},
    time::Clock,
};

use cli_common::{exit, remote::authority_beside, show};

use crate::commands::{
    args::{LogArgs, start_log},
    detach,
};

/// Wait on this host for boots of other hosts, and run their chassis
///
/// A boot whose app has `[host.NAME] agent = "IP:PORT"` sends the app's files here, and its chassis with `host = "NAME"`
/// are started as processes of this program, with this program's event handlers. Their logs go to the boot. Whoever boots
/// needs a key with the role `boot`; without keys the agent listens at the loopback only, for its own user. When a boot
/// is gone for longer than its `app.peer_timeout_s`, what it started is ended. Ctrl-C ends everything and the agent.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos agent
  ctos agent --listen 192.168.1.20:7410 --key keys/cage")]
pub struct AgentArgs {
    /// Where to listen; port 0 is a free one
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:7410")]
    pub listen: SocketAddr,
    /// Key of this agent without its ending, made by `ctos keys new --role boot`
    #[arg(long, value_name = "DIR/NAME")]
    pub key: Option<PathBuf>,
    /// Certificate of the authority of all keys; `ca.pem` beside the key when it is left out
    #[arg(long, value_name = "FILE", requires = "key")]
    pub authority: Option<PathBuf>,
    /// Folder in which each app gets a folder of its own, removed afterwards; records stay in it. Default: that for
    /// temporary files
    #[arg(long, value_name = "WORKDIR")]
    pub dir: Option<PathBuf>,
    /// Print one JSON object per event
    #[arg(long)]
    pub json: bool,
    /// How much to say
    #[command(flatten)]
    pub log: LogArgs,
}

/// Runs the command.
#[must_use]
pub fn run(args: &AgentArgs, registry: Registry) -> u8 {
    if let Err(code) = start_log(&args.log, Clock::real(), true, String::new()) {
        return code;
    }
    let program = match std::env::current_exe() {
        Ok(program) => program,
        Err(error) => {
            show::say(&format!(
                "error: cannot find this program's own file: {error}"
            ));
            return exit::UNREACHABLE;
        }
    };
    let key = args.key.as_ref().map(|key| {
        let authority = args.authority.clone();
        (
            key.clone(),
            authority.unwrap_or_else(|| authority_beside(key)),
        )
    });
    let setup = AgentSetup {
        listen: args.listen,
        key,
        folder: args.dir.clone().unwrap_or_else(std::env::temp_dir),
        program,
    };
    let (json, quiet) = (args.json, args.log.quiet);
    let observer: AgentObserver = Arc::new(move |event| {
        if matches!(event, AgentEvent::Listening { .. }) {
            detach::notify_ready();
        }
        if json {
            // A reader that went away does not end the apps.
            let _ = show::data(&serde_json::to_string(event).unwrap_or_default());
        } else if !quiet {
            show::say(&words(event));
        }
    });
    match HostAgent::run(setup, registry, &observer) {
        Ok(()) => exit::OK,
        Err(error) => {
            show::say(&format!("error: {error}"));
            match error {
                AgentError::NoKey(_) => exit::USAGE,
                _ => exit::FAILED,
            }
        }
    }
}

/// An event as a line.
fn words(event: &AgentEvent) -> String {
    match event {
        AgentEvent::Listening { address } => format!("agent    listens at {address}"),
        AgentEvent::Boot { app, from } => format!("boot     {app} from {from}"),
        AgentEvent::Started { app, chassis, pid } => {
            let pid = pid.map_or_else(String::new, |pid| format!("pid {pid}"));
            format!("chassis  {app}/{chassis}  {pid}")
        }
        AgentEvent::Ended { app, chassis, how } => format!("ended    {app}/{chassis} {how}"),
        AgentEvent::Over { app, why } => format!("over     {app}: {why}"),
        AgentEvent::Refused { who, reason } => format!("refused  {who}: {reason}"),
        other => format!("{other:?}"),
    }
}
