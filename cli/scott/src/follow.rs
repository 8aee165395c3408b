//! What an app says while somebody sits at the prompt: its warnings and errors, and that it is gone or back. It
//! stands above the line that is being edited.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{RecvTimeoutError, SyncSender, channel},
    },
    thread,
    time::Duration,
};

use ctos::control::{
    Level, LogLine,
    protocol::{Answer, LogRequest, Request},
};

use super::attach::Where;
use cli_common::{
    client::{Client, ClientError},
    remote::{connect_to, log_text},
};

/// How often the prompt looks whether an app that is gone is back.
const LOOK: Duration = Duration::from_millis(500);

/// Sends what the app says, line by line, until nobody takes it any more. `gone` says at any moment whether it is
/// there. It is set before the line about it is sent, because that line makes the prompt be drawn again.
pub fn start(name: String, place: Where, above: SyncSender<String>, gone: Arc<AtomicBool>) {
    thread::spawn(move || {
        // Nothing is ever sent: it is what pauses.
        let (_never, pause) = channel::<()>();
        loop {
            let connected = connect_to(place.app.as_deref(), &place.at);
            if let Ok(mut client) = connected {
                let was_gone = gone.swap(false, Ordering::Relaxed);
                if was_gone && above.send(format!("-- app `{name}` is back --")).is_err() {
                    return;
                }
                // How it ended is seen from here alike.
                let _ = follow(&mut client, &above);
            }
            let was_gone = gone.swap(true, Ordering::Relaxed);
            if !was_gone && above.send(format!("-- app `{name}` is gone --")).is_err() {
                return;
            }
            if pause.recv_timeout(LOOK) == Err(RecvTimeoutError::Disconnected) {
                return;
            }
        }
    });
}

/// Until the app closes the connection.
fn follow(client: &mut Client, above: &SyncSender<String>) -> Result<(), ClientError> {
    client.ask(Request::Logs(LogRequest {
        level: Some(Level::Warn),
        last: Some(0),
        follow: true,
        ..LogRequest::default()
    }))?;
    client.wait_for_ever()?;
    while let Some(answer) = client.read()? {
        let line = match answer {
            Answer::Log(line) => shown(&line),
            Answer::Lost { lines } => format!("… {lines} lines of the log were lost"),
            _ => return Ok(()),
        };
        if above.send(line).is_err() {
            return Ok(());
        }
    }
    Ok(())
}

fn shown(line: &LogLine) -> String {
    format!("{} │ {}", line.chassis, log_text(line))
}
