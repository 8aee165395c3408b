//! What a person at a terminal is told while an answer takes long. It knows neither objects nor apps.

use std::{
    io::{self, IsTerminal as _},
    sync::{
        LazyLock,
        mpsc::{RecvTimeoutError, Sender, channel},
    },
    thread,
    time::Duration,
};

use cli_common::{show, table};

/// A person wonders after this.
pub const PATIENCE: Duration = Duration::from_millis(300);

/// Who is told about requests that are met in this process: `Some` when one begins, `None` when it has ended.
static TELLER: LazyLock<Option<Sender<Option<String>>>> =
    LazyLock::new(|| is_there().then(|| teller(tell)));

/// Whether a person reads what is said beside the answers.
pub fn is_there() -> bool {
    io::stderr().is_terminal()
}

/// Tells a person what is waited for.
pub fn tell(what: &str) {
    show::say(&table::for_messages(&format!("waiting: {what}")));
}

/// Does what may take long; then a person hears of it.
pub fn during<T>(line: &str, act: impl FnOnce() -> T) -> T {
    let Some(teller) = &*TELLER else { return act() };
    // Without the thread nobody is told, and nothing else changes.
    let _ = teller.send(Some(line.to_owned()));
    let done = act();
    let _ = teller.send(None);
    done
}

fn teller(tell: impl Fn(&str) + Send + 'static) -> Sender<Option<String>> {
    let (teller, told) = channel::<Option<String>>();
    thread::spawn(move || {
        while let Ok(said) = told.recv() {
            let Some(line) = said else { continue };
            if told.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                let object = line.split_whitespace().next().unwrap_or_default();
                let time = PATIENCE.as_secs_f64();
                tell(&format!(
                    "`{object}` is busy with this for {time} s; Ctrl-C ends scott, and with it the request"
                ));
            }
        }
    });
    teller
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_long_here_is_told_once_with_the_object_and_the_way_out() {
        let (tells, told) = channel();
        let teller = teller(move |text| tells.send(text.to_owned()).unwrap());
        teller.send(Some("bundle EXEC lamps.csv".into())).unwrap();
        let text = told.recv().unwrap();
        assert!(text.starts_with("`bundle` is busy with this for"), "{text}");
        assert!(text.contains("Ctrl-C ends scott"), "{text}");
        teller.send(None).unwrap();
        drop(teller);
        assert!(told.recv().is_err());
    }
}
