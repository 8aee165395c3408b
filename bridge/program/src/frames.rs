//! Large bytes beside the lines: a file of its own in shared memory, which a line names: `{"frame": "NAME", "bytes": N}`.
//!
//! Each program has a folder that only its user can enter. Who writes a frame names it in one line; who reads that line
//! has it from then on, and removes it. What is left over goes with the folder, when the program has ended.

use std::{
    fs::{self, DirBuilder, File, OpenOptions},
    io::{Read as _, Write as _},
    os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use rustix::fs::OFlags;
use serde_json::Value;

/// Memory that all processes of the host share.
const SHARED: &str = "/dev/shm";
/// How the folders of all programs are called, before the numbers of this process and of the program.
const PREFIX: &str = "ctos-frames-";
/// Fewer bytes go as base64.
const LEAST: usize = 1 << 16;
/// The longest name.
const NAME: usize = 64;

/// The frames of one program. Dropped, all that are left are removed.
#[derive(Debug)]
pub(crate) struct Frames {
    folder: PathBuf,
    next: AtomicU64,
    /// The largest, bytes.
    most: u64,
}

impl Frames {
    /// A folder for a program whose frames have at most so many bytes. Nothing where there is no shared memory: then
    /// all bytes go as base64.
    pub(crate) fn new(most: usize) -> Option<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        remove_stale();
        let (own, count) = (std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let folder = Path::new(SHARED).join(format!("{PREFIX}{own}-{count}"));
        DirBuilder::new().mode(0o700).create(&folder).ok()?;
        Some(Self {
            folder,
            next: AtomicU64::new(1),
            most: u64::try_from(most).unwrap_or(u64::MAX),
        })
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Appends bytes to a line: as a frame, or as base64 where they are few or no frame can be made.
    pub(crate) fn write(&self, bytes: &[u8], json: &mut Vec<u8>) {
        if bytes.len() < LEAST {
            return base64(bytes, json);
        }
        let name = format!("h{}", self.next.fetch_add(1, Ordering::Relaxed));
        let path = self.folder.join(&name);
        let made = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&path);
        match made.and_then(|mut file| file.write_all(bytes)) {
            Ok(()) => {
                json.extend(format!("{{\"frame\":\"{name}\",\"bytes\":{}}}", bytes.len()).bytes())
            }
            Err(error) => {
                tracing::debug!(%error, "a frame cannot be written");
                // What there is of it would only take room.
                let _ = fs::remove_file(&path);
                base64(bytes, json);
            }
        }
    }

    /// A line of the program with the bytes of its frames in their places, as base64.
    ///
    /// # Errors
    /// A frame that is none.
    pub(crate) fn resolved(&self, line: String) -> Result<String, String> {
        if !line.contains("\"frame\"") {
            return Ok(line);
        }
        // What is no JSON is told by who reads the line.
        let Ok(mut value) = serde_json::from_str(&line) else {
            return Ok(line);
        };
        match self.resolve(&mut value)? {
            true => Ok(value.to_string()),
            false => Ok(line),
        }
    }

    fn resolve(&self, value: &mut Value) -> Result<bool, String> {
        let mut found = false;
        match value {
            Value::Array(all) => {
                for one in all {
                    found |= self.resolve(one)?;
                }
            }
            Value::Object(all) => {
                if let (2, Some(Value::String(name)), Some(bytes)) = (
                    all.len(),
                    all.get("frame"),
                    all.get("bytes").and_then(Value::as_u64),
                ) {
                    let taken = self.take(name, bytes);
                    let bytes = taken.map_err(|why| {
                        format!("its program wrote a frame `{name}` that is none: {why}")
                    })?;
                    *value = Value::String(STANDARD.encode(bytes));
                    return Ok(true);
                }
                for one in all.values_mut() {
                    found |= self.resolve(one)?;
                }
            }
            _ => {}
        }
        Ok(found)
    }

    fn take(&self, name: &str, bytes: u64) -> Result<Vec<u8>, String> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || name.len() > NAME || !name.chars().all(plain) {
            return Err(format!(
                "a name is at most {NAME} letters, digits, `-` and `_`"
            ));
        }
        if bytes > self.most {
            return Err(format!("it has {bytes} bytes, and may have {}", self.most));
        }
        let path = self.folder.join(name);
        // A link would lead elsewhere, and a pipe has no end.
        let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let flags = i32::try_from(flags.bits()).unwrap_or(0);
        let said = |error: std::io::Error| error.to_string();
        let file = OpenOptions::new()
            .read(true)
            .custom_flags(flags)
            .open(&path)
            .map_err(said)?;
        let whole = read(file, bytes).map_err(said)?;
        fs::remove_file(&path).map_err(said)?;
        whole.ok_or_else(|| format!("it is no file of {bytes} bytes"))
    }
}

fn read(file: File, bytes: u64) -> std::io::Result<Option<Vec<u8>>> {
    let about = file.metadata()?;
    if !about.is_file() || about.len() != bytes {
        return Ok(None);
    }
    let mut whole = Vec::new();
    file.take(bytes).read_to_end(&mut whole)?;
    Ok((whole.len() as u64 == bytes).then_some(whole))
}

impl Drop for Frames {
    fn drop(&mut self) {
        // It goes with the next program otherwise.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Removes the folders of processes that are gone.
fn remove_stale() {
    let Ok(all) = fs::read_dir(SHARED) else {
        return;
    };
    for entry in all.flatten() {
        let name = entry.file_name();
        let owner = name.to_str().and_then(|name| name.strip_prefix(PREFIX));
        let owner = owner.and_then(|rest| rest.split('-').next());
        if owner.is_some_and(|owner| !Path::new("/proc").join(owner).exists()) {
            // Those of others cannot be removed, and need not.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// Appends bytes to a line as base64.
pub(crate) fn base64(bytes: &[u8], json: &mut Vec<u8>) {
    json.push(b'"');
    json.extend(STANDARD.encode(bytes).bytes());
    json.push(b'"');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_read_once_and_nothing_is_read_that_is_none() {
        let frames = Frames::new(1000).unwrap();
        let put = |name: &str, bytes: &[u8]| fs::write(frames.folder().join(name), bytes).unwrap();
        let line = |name: &str, bytes: u64| {
            format!(
                "{{\"reply\":{{\"id\":1,\"data\":[{{\"frame\":\"{name}\",\"bytes\":{bytes}}}]}}}}"
            )
        };
        put("a", &[1, 2, 3]);
        let read = frames.resolved(line("a", 3)).unwrap();
        assert_eq!(read, "{\"reply\":{\"data\":[\"AQID\"],\"id\":1}}");
        assert!(!frames.folder().join("a").exists());
        put("a", &[1, 2, 3]);
        put("long", &[0; 1001]);
        std::os::unix::fs::symlink("/etc/hostname", frames.folder().join("link")).unwrap();
        fs::create_dir(frames.folder().join("folder")).unwrap();
        for (name, bytes, why) in [
            ("b", 3, "No such file"),
            ("a", 4, "it is no file of 4 bytes"),
            ("long", 1001, "it has 1001 bytes, and may have 1000"),
            ("../x", 3, "a name is at most"),
            ("", 3, "a name is at most"),
            ("/etc/hostname", 3, "a name is at most"),
            ("link", 3, "that is none"),
            ("folder", 3, "that is none"),
        ] {
            let error = frames.resolved(line(name, bytes)).unwrap_err();
            assert!(error.contains(why), "{name}: {error}");
        }
        // What only looks like one is left alone.
        for plain in [
            "{\"frame\":\"a\"}",
            "{\"frame\":1,\"bytes\":2}",
            "no JSON \"frame\"",
        ] {
            assert_eq!(frames.resolved(plain.to_owned()).unwrap(), plain);
        }
        let folder = frames.folder().to_owned();
        drop(frames);
        assert!(!folder.exists());
    }

    #[test]
    fn few_bytes_go_as_base64_and_many_as_a_frame() {
        let frames = Frames::new(1 << 20).unwrap();
        let mut json = Vec::new();
        frames.write(&[1, 2, 3], &mut json);
        assert_eq!(json, b"\"AQID\"");
        let mut json = Vec::new();
        frames.write(&vec![7; LEAST], &mut json);
        let told: Value = serde_json::from_slice(&json).unwrap();
        let file = frames.folder().join(told["frame"].as_str().unwrap());
        assert_eq!(fs::read(file).unwrap(), vec![7; LEAST]);
    }
}
