//! The class `sound` tells people in the room by recorded comments, spoken words and a beep. It is the speaker daemon
//! of the SORMA technical report, section 2.1.3.
//!
//! What is said also stands in the log and in the answer, which goes to all who subscribe to the object. `fork.sound`
//! keeps messages in order without anybody waiting for them.

use crate::class::Class;
use crate::description::{ClassInfo, Form};
use crate::ipc::answer::split;
use crate::object::{Context, Outcome, ServiceObject};
use crate::options::OptionTable;
use crate::raise;
use crate::report::{Report, code as general};
use crate::sorm::Sorm;
use crate::transport::Transport;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Version of the class.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The recipes that are shipped with the class. One message after the other is said, and nobody waits for it.
/// A `sound.beep` signals by a tone, and a `sound.text` by the text alone, which its subscribers get as an event.
pub const DICTIONARY: &str =
    "fork.sound -object sound -width 1\nsound.beep -beep on\nsound.text -mute on\n";

/// Whether this process makes no sound.
static SILENT: AtomicBool = AtomicBool::new(false);

/// From now on no object of this process makes a sound; all write what they would say. For a program whose user wants
/// that (`--quiet`).
pub fn silence() {
    SILENT.store(true, Ordering::Relaxed);
}

/// The word that is a tone.
const BEEP: &str = "beep";

/// The endings of recordings, of which a word may leave out the first.
const ENDINGS: [&str; 2] = ["wav", "snd"];

#[derive(Debug, Clone)]
struct Options {
    folder: String,
    voice: String,
    player: String,
    beep: bool,
    mute: bool,
    longest_s: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            folder: String::new(),
            voice: "espeak-ng".to_owned(),
            player: "aplay".to_owned(),
            beep: false,
            mute: false,
            longest_s: 30.0,
        }
    }
}

static TABLE: LazyLock<OptionTable<Options>> = LazyLock::new(|| {
    OptionTable::new(
        "tells people in the room. EXEC WORD ..: a word that names a recording is played, `beep` is a tone, all others are \
         spoken. The text also goes to the log and to all who subscribe. On a virtual clock nothing is to be heard",
    )
    .exec(&[Form {
        text: "WORD ..",
        floats: 0,
        takes: "",
        gives: "the text, and IMSG 1: 1 when all of it was to be heard, 0 when it was only written",
        results: "",
        help: "says it, and answers when that is done",
    }])
    .word(
        "folder",
        "FOLDER",
        "where recordings are, WORD.wav or WORD.snd; empty: there are none",
        |options: &mut Options| &mut options.folder,
    )
    .word(
        "voice",
        "PROGRAM",
        "speaks the text that is its last argument; empty: nothing is spoken",
        |options| &mut options.voice,
    )
    .word(
        "player",
        "PROGRAM",
        "plays the file that is its last argument, or with `-` its standard input; empty: nothing is played",
        |options| &mut options.player,
    )
    .flag(
        "beep",
        "a tone in place of all that is played and spoken",
        |options| &mut options.beep,
    )
    .flag("mute", "only writes", |options| &mut options.mute)
    .float(
        "longest",
        0.1..=600.0,
        "s",
        "what a program has not said after this time is broken off",
        |options| &mut options.longest_s,
    )
});

/// Makes the class known to a manager.
pub fn register(sorm: &Sorm) {
    let class = Class::new("sound", VERSION, |_, sorm| {
        let is_virtual = sorm.clock().origin_ns().is_none();
        let options = Options::default();
        Ok(Box::new(Sound {
            options,
            is_virtual,
        }))
    });
    sorm.register(class.described(TABLE.class("sound", VERSION)).any_flavor());
}

/// What a program may know about the class.
#[must_use]
pub fn classes() -> Vec<ClassInfo> {
    vec![TABLE.class("sound", VERSION)]
}

/// An object of the class.
struct Sound {
    options: Options,
    /// Whether the clock is virtual: no time passes while something is said.
    is_virtual: bool,
}

/// A piece of a message.
#[derive(Debug, PartialEq)]
enum Piece {
    Recording(PathBuf),
    Beep,
    Spoken(String),
}

/// The pieces of a message: words that stand together are spoken together.
///
/// # Errors
/// A word with the ending of a recording that is not in the folder.
fn pieces(words: &[String], folder: &str) -> Result<Vec<Piece>, Report> {
    let mut pieces = Vec::new();
    for word in words {
        let piece = match recording(word, folder)? {
            Some(path) => Piece::Recording(path),
            None if word == BEEP => Piece::Beep,
            None => Piece::Spoken(word.clone()),
        };
        match (pieces.last_mut(), piece) {
            (Some(Piece::Spoken(text)), Piece::Spoken(word)) => {
                text.push(' ');
                text.push_str(&word);
            }
            (_, piece) => pieces.push(piece),
        }
    }
    Ok(pieces)
}

/// The file of a word that names a recording. A name with a separator names none, so nothing outside the folder is
/// played.
fn recording(word: &str, folder: &str) -> Result<Option<PathBuf>, Report> {
    let name = Path::new(word);
    let has_ending = name
        .extension()
        .is_some_and(|end| ENDINGS.iter().any(|ending| end == *ending));
    let is_plain = name.file_name().is_some_and(|file| file == word);
    if is_plain && !folder.is_empty() {
        let folder = Path::new(folder);
        let mut files = vec![folder.join(word)];
        files.extend(ENDINGS.map(|ending| folder.join(format!("{word}.{ending}"))));
        let files = if has_ending { &files[..1] } else { &files[1..] };
        if let Some(file) = files.iter().find(|file| file.is_file()) {
            return Ok(Some(file.clone()));
        }
    }
    if has_ending {
        return Err(raise!(
            general::VALUE,
            "there is no recording `{word}` in the folder `{folder}`; name its folder with -folder"
        ));
    }
    Ok(None)
}

impl Sound {
    /// # Errors
    /// Why it cannot be heard.
    fn say(&self, piece: &Piece) -> io::Result<()> {
        let run = |program: &str, argument: &Path, input: &[u8]| {
            let longest = Duration::from_secs_f64(self.options.longest_s);
            run(program, argument, input, longest)
        };
        match piece {
            Piece::Recording(file) => run(&self.options.player, file, &[]),
            Piece::Beep => run(&self.options.player, Path::new("-"), &tone()),
            Piece::Spoken(text) => {
                // A text that begins with a dash is not an option of the program.
                let text = text.trim_start_matches('-');
                run(&self.options.voice, Path::new(text), &[])
            }
        }
    }
}

/// Has a program say something, and kills it when that takes longer.
fn run(program: &str, argument: &Path, input: &[u8], longest: Duration) -> io::Result<()> {
    let named = |reason: &dyn std::fmt::Display| io::Error::other(format!("`{program}`: {reason}"));
    if program.is_empty() {
        return Err(io::Error::other("no program is set for it"));
    }
    let mut child = Command::new(program)
        .arg(argument)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|error| named(&error))?;
    if let Some(mut pipe) = child.stdin.take() {
        // It fits into the pipe. A program that does not read it says with its exit code whether it minds.
        let _ = pipe.write_all(input);
    }
    let has_ended = has_ended(&child, longest);
    if !matches!(has_ended, Ok(true)) {
        child.kill()?;
    }
    let status = child.wait()?;
    match has_ended? {
        true if status.success() => Ok(()),
        true => Err(named(&status)),
        false => Err(named(&format!("broken off after {longest:?}"))),
    }
}

/// Whether a process ends within that time.
fn has_ended(child: &Child, within: Duration) -> io::Result<bool> {
    let process = pidfd_open(Pid::from_child(child), PidfdFlags::empty())?;
    let within = Timespec::try_from(within).map_err(io::Error::other)?;
    let mut ends = [PollFd::new(&process, PollFlags::IN)];
    Ok(poll(&mut ends, Some(&within))? > 0)
}

/// A fifth of a second of 880 Hz, as a WAV file: 8 kHz, one channel, 8 bits.
fn tone() -> Vec<u8> {
    const RATE: u32 = 8_000;
    const SAMPLES: u32 = RATE / 5;
    let mut file = Vec::new();
    file.extend(b"RIFF");
    file.extend((36 + SAMPLES).to_le_bytes());
    file.extend(b"WAVEfmt ");
    file.extend(16_u32.to_le_bytes());
    file.extend([1_u16, 1].map(u16::to_le_bytes).concat());
    file.extend([RATE, RATE].map(u32::to_le_bytes).concat());
    file.extend([1_u16, 8].map(u16::to_le_bytes).concat());
    file.extend(b"data");
    file.extend(SAMPLES.to_le_bytes());
    file.extend((0..SAMPLES).map(|i| {
        let phase = f64::from(i) * 880.0 / f64::from(RATE) * std::f64::consts::TAU;
        // Between 28 and 228: the cast keeps it.
        (128.0 + 100.0 * phase.sin()) as u8
    }));
    file
}

impl ServiceObject for Sound {
    fn exec(&mut self, cx: &Context<'_>, io: &mut Transport) -> Outcome {
        let words = split(&io.text)?;
        if words.is_empty() {
            return Err(raise!(
                general::VALUE,
                "EXEC takes words, and there are none"
            ));
        }
        let pieces = match self.options.beep {
            true => vec![Piece::Beep],
            false => pieces(&words, &self.options.folder)?,
        };
        let text = words.join(" ");
        tracing::info!(target: "sorma::sound", object = %cx.name(), "{text}");
        let is_silent = SILENT.load(Ordering::Relaxed);
        let mut is_heard = !self.options.mute && !self.is_virtual && !is_silent;
        if is_heard {
            for piece in &pieces {
                if let Err(error) = self.say(piece) {
                    tracing::warn!(target: "sorma::sound", object = %cx.name(), %error, "only written");
                    is_heard = false;
                }
            }
        }
        io.empty();
        io.text = text;
        io.ints.push(i64::from(is_heard));
        Ok(())
    }

    fn ctrl(&mut self, _cx: &Context<'_>, io: &mut Transport) -> Outcome {
        TABLE.ctrl(&mut self.options, io);
        Ok(())
    }

    fn dump(&self) -> String {
        TABLE.dump(&self.options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alone, Dictionary, Keep, Reply, asynchronous};
    use ctos::{diagnostic::Source, time::Clock};
    use futures_util::FutureExt as _;
    use std::fs;
    use std::os::unix::fs::PermissionsExt as _;

    /// A manager whose `sound` has programs that write what they were given to a file, a line each.
    struct Room {
        folder: tempfile::TempDir,
        sorm: Sorm,
    }

    impl Room {
        fn new(clock: Clock) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let mut dictionary = Dictionary::new();
            let shipped = Source::new("shipped", DICTIONARY);
            dictionary.load(&shipped).unwrap();
            let sorm = Sorm::of("room", clock, dictionary);
            asynchronous::register(&sorm);
            register(&sorm);
            let room = Self { folder, sorm };
            room.program("voice", "echo said \"$1\" >> \"$heard\"");
            let plays = "echo played $(basename \"$1\") $(head -c 4) >> \"$heard\"";
            room.program("player", plays);
            let folder = room.folder.path().display();
            let set = room.ask(&format!(
                "sound CTRL -voice {folder}/voice -player {folder}/player -folder {folder}"
            ));
            assert!(set.is_ok(), "{set:?}");
            room
        }

        fn program(&self, name: &str, line: &str) {
            let path = self.folder.path().join(name);
            let heard = self.folder.path().join("heard");
            let script = format!("#!/bin/sh\nheard='{}'\n{line}\n", heard.display());
            fs::write(&path, script).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).unwrap();
        }

        fn recording(&self, name: &str) {
            fs::write(self.folder.path().join(name), tone()).unwrap();
        }

        fn heard(&self) -> Vec<String> {
            let text = fs::read_to_string(self.folder.path().join("heard")).unwrap_or_default();
            text.lines().map(str::to_owned).collect()
        }

        fn ask(&self, line: &str) -> Transport {
            self.sorm.dispatch(line).parse::<Reply>().unwrap().body
        }
    }

    #[test]
    fn recordings_are_played_and_other_words_spoken_together_in_their_order() {
        let room = Room::new(Clock::real());
        room.recording("lost.wav");
        room.recording("alertPowerUp.snd");
        let answer = room.ask("sound EXEC lost at D 4 beep alertPowerUp.snd");
        assert_eq!(
            (answer.text.as_str(), answer.ints.as_slice()),
            ("lost at D 4 beep alertPowerUp.snd", &[1][..])
        );
        let heard = [
            "played lost.wav",
            "said at D 4",
            "played - RIFF",
            "played alertPowerUp.snd",
        ];
        assert_eq!(room.heard(), heard);
    }

    #[test]
    fn a_recording_that_is_not_in_the_folder_is_an_error_and_nothing_is_heard() {
        let room = Room::new(Clock::real());
        fs::create_dir(room.folder.path().join("inner")).unwrap();
        room.recording("inner/secret.wav");
        for word in ["secret.wav", "inner/secret.wav", "../heard.wav"] {
            let answer = room.ask(&format!("sound EXEC attention {word}"));
            assert_eq!(answer.code, general::VALUE, "{word}");
            assert!(answer.reports[0].text.contains(word), "{answer:?}");
        }
        assert_eq!(room.ask("sound EXEC ''").code, general::VALUE);
        assert!(room.heard().is_empty());
    }

    #[test]
    fn a_text_is_no_option_of_the_program_that_speaks_it() {
        let room = Room::new(Clock::real());
        room.ask("sound EXEC '--version of this'");
        assert_eq!(room.heard(), ["said version of this"]);
    }

    #[test]
    fn what_cannot_be_heard_is_written_and_the_answer_says_so() {
        let room = Room::new(Clock::real());
        room.program("deaf", "exit 3");
        room.program("endless", "exec sleep 1000");
        for voice in ["deaf", "endless", "missing"] {
            let path = room.folder.path().join(voice);
            let set = format!("sound CTRL -voice {} -longest 0.1", path.display());
            assert!(room.ask(&set).is_ok());
            let answer = room.ask("sound EXEC disc lost");
            assert_eq!(
                (answer.text.as_str(), answer.ints.as_slice()),
                ("disc lost", &[0][..]),
                "{voice}"
            );
        }
    }

    #[test]
    fn nothing_is_heard_when_muted_or_on_a_virtual_clock() {
        let muted = Room::new(Clock::real());
        muted.ask("sound CTRL -mute on");
        for room in [muted, Room::new(Clock::virtual_clock())] {
            let answer = room.ask("sound EXEC disc lost");
            assert_eq!(
                (answer.text.as_str(), answer.ints.as_slice()),
                ("disc lost", &[0][..])
            );
            assert!(room.heard().is_empty());
        }
    }

    #[test]
    fn a_signal_by_beep_or_by_text_alone_is_the_same_event_for_its_subscribers() {
        for (flavor, heard) in [("beep", &["played - RIFF"][..]), ("text", &[])] {
            let room = Room::new(Clock::real());
            let (name, folder) = (format!("sound.{flavor}"), room.folder.path().display());
            let set = format!("{name} CTRL -voice {folder}/voice -player {folder}/player");
            assert!(room.ask(&set).is_ok());
            let subscribed = room.sorm.subscribe(&Alone, &name, Keep::Latest);
            let mut event = subscribed.now_or_never().unwrap().unwrap();
            let answer = room.ask(&format!("{name} EXEC disc lost at D 4"));
            assert_eq!(answer.ints, [i64::from(!heard.is_empty())], "{name}");
            assert_eq!(room.heard(), heard, "{name}");
            let sample = event.try_next().unwrap();
            assert_eq!(sample.body.text, "disc lost at D 4", "{name}");
        }
    }

    #[test]
    fn the_shipped_flavor_of_fork_has_it_said_behind_the_callers_back() {
        let room = Room::new(Clock::real());
        let answer = room.ask("fork.sound EXEC disc lost");
        assert_eq!(answer.ints, [1], "{answer:?}");
    }

    #[test]
    fn the_tone_is_a_wav_file_whose_sizes_are_true() {
        let tone = tone();
        let number = |at: usize| u32::from_le_bytes(tone[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((number(4), number(40)), (tone.len() - 8, tone.len() - 44));
    }
}
