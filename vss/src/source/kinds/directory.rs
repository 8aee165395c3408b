//! The pictures in a folder, in the order of their names or of a table of stamps.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use ctos::{Context, diagnostic::Source, task::HandlerError};
use futures_util::future::LocalBoxFuture;
use serde::Deserialize;
use vss_image::{FILE_MOST, Picture};

use super::{Args, Camera, seconds, stamp};
use crate::{
    frame::{Frame, FrameError},
    source::FrameSource,
};

/// The word for stamps in names.
const NAMES: &str = "names";

/// Names of pictures end so; what they are is decided by their content.
const ENDINGS: [&str; 8] = ["png", "jpg", "jpeg", "pgm", "ppm", "pbm", "pnm", "bmp"];

/// Arguments of `vss.directory`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DirectoryArgs {
    /// The folder, relative to the configuration's.
    folder: String,
    /// `names`, or a table `name,stamp_s` in the folder.
    stamps: Option<String>,
    /// Time between two pictures, s.
    period_s: Option<f64>,
    /// How long each exposure was, s.
    #[serde(default)]
    exposure_s: f64,
    /// Whether the first picture comes again after the last.
    #[serde(default)]
    repeat: bool,
}

impl Args for DirectoryArgs {
    fn wrong(&self) -> Option<String> {
        let period = self.period_s.map(|period| seconds("period_s", period));
        if let Some(Err(why)) = period {
            return Some(why);
        }
        if let Err(why) = seconds("exposure_s", self.exposure_s) {
            return Some(why);
        }
        match (&self.stamps, self.period_s, self.repeat) {
            (Some(_), Some(_), _) => {
                Some("`stamps` and `period_s` say the same: give one".to_owned())
            }
            (Some(_), _, true) => {
                Some("`repeat` would bring the same `stamps` again: give `period_s`".to_owned())
            }
            _ => None,
        }
    }
}

/// A picture's file and its stamp, if it has one.
pub(super) type Listed = (PathBuf, Option<Duration>);

/// The pictures in a folder.
pub(super) struct Directory {
    camera: Camera,
    args: DirectoryArgs,
    folder: PathBuf,
    /// Not looked for yet, in a replay.
    listed: Option<Vec<Listed>>,
}

impl Directory {
    pub(super) fn new(
        cx: &Context,
        camera: &str,
        args: DirectoryArgs,
    ) -> Result<Self, HandlerError> {
        let mut own = Self {
            camera: Camera::new(camera),
            folder: cx.path(&args.folder),
            args,
            listed: None,
        };
        if !cx.is_replay() {
            own.listed = Some(own.list().map_err(HandlerError::new)?);
        }
        Ok(own)
    }

    fn list(&self) -> Result<Vec<Listed>, String> {
        let folder = self.folder.display();
        let listed = match self.args.stamps.as_deref() {
            None => named(&self.folder)?
                .into_iter()
                .map(|path| (path, None))
                .collect(),
            Some(NAMES) => {
                let paths = named(&self.folder)?.into_iter();
                let stamped = paths.map(|path| {
                    let stamp = stamp_of(&path)?;
                    Ok((path, Some(stamp)))
                });
                let mut stamped = stamped.collect::<Result<Vec<Listed>, String>>()?;
                stamped.sort_by_key(|(_, stamp)| *stamp);
                ascending(&stamped)?;
                stamped
            }
            Some(table) => from_table(&self.folder, table)?,
        };
        if listed.is_empty() {
            return Err(format!(
                "no pictures are in `{folder}` ({})",
                ENDINGS.join(", ")
            ));
        }
        Ok(listed)
    }

    /// The next picture, and whether it has a stamp.
    fn next(&mut self) -> Result<(Frame, bool), String> {
        let listed = match self.listed.take() {
            Some(listed) => listed,
            None => self.list()?,
        };
        let listed = self.listed.insert(listed);
        let nth = usize::try_from(self.camera.taken).unwrap_or(usize::MAX);
        let nth = if self.args.repeat {
            nth % listed.len().max(1)
        } else {
            nth
        };
        let Some((path, stamp)) = listed.get(nth) else {
            let (count, folder) = (listed.len(), self.folder.display());
            return Err(format!(
                "all {count} pictures of `{folder}` are taken; `repeat = true` begins again"
            ));
        };
        let picture = opened(path)?;
        let exposure = seconds("exposure_s", self.args.exposure_s)?;
        let frame = self
            .camera
            .frame(picture, stamp.unwrap_or_default(), exposure);
        Ok((frame, stamp.is_some()))
    }

    async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let read = cx.outside("the next picture of a folder", || self.next());
        let (mut frame, stamped) = read.map_err(|why| self.camera.fault(why))?;
        if !stamped {
            frame.stamp = stamp(cx, self.args.period_s, frame.number);
        }
        Ok(frame)
    }
}

impl FrameSource for Directory {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}

/// Pictures of a folder, by name.
fn named(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let wrong =
        |error: std::io::Error| format!("cannot read the folder `{}`: {error}", folder.display());
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(wrong)? {
        let path = entry.map_err(wrong)?.path();
        let ending = path
            .extension()
            .and_then(|ending| ending.to_str())
            .unwrap_or_default();
        if ENDINGS
            .iter()
            .any(|known| known.eq_ignore_ascii_case(ending))
            && path.is_file()
        {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// The last number in a file's name: seconds if it has a point, else nanoseconds, as common data sets have it.
pub(super) fn stamp_of(path: &Path) -> Result<Duration, String> {
    let stem = path
        .file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or_default();
    let numbers = stem.split(|letter: char| !(letter.is_ascii_digit() || letter == '.'));
    let last = numbers
        .map(|number| number.trim_matches('.'))
        .rfind(|number| !number.is_empty());
    let stamp = last.and_then(|number| match number.contains('.') {
        true => Duration::try_from_secs_f64(number.parse().ok()?).ok(),
        false => number.parse().ok().map(Duration::from_nanos),
    });
    stamp.ok_or_else(|| {
        format!(
            "the name of `{}` ends with no stamp: seconds with a point, or nanoseconds, as in `left_1.250.png`",
            path.display()
        )
    })
}

/// Refuses stamps that do not ascend.
fn ascending(stamped: &[Listed]) -> Result<(), String> {
    for pair in stamped.windows(2) {
        if let [(one, Some(before)), (other, Some(stamp))] = pair
            && stamp <= before
        {
            let (one, other) = (one.display(), other.display());
            return Err(format!(
                "`{other}` has no later stamp than `{one}`: {stamp:?} after {before:?}"
            ));
        }
    }
    Ok(())
}

/// The pictures that a table names, with their stamps.
pub(super) fn from_table(folder: &Path, table: &str) -> Result<Vec<Listed>, String> {
    let source = Source::read(&folder.join(table)).map_err(|finding| finding.to_string())?;
    let mut listed: Vec<Listed> = Vec::new();
    let (mut at, mut headed) = (0, false);
    for line in source.text().split_inclusive('\n') {
        let start = at;
        at += line.len();
        let text = line.trim();
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let wrong = |why: String| {
            let (line, column) = source.line_column(start);
            Err(format!("{}:{line}:{column}: {why}", source.name()))
        };
        if !headed {
            if text != "name,stamp_s" {
                return wrong(format!(
                    "the first line must be `name,stamp_s`, not `{text}`"
                ));
            }
            headed = true;
            continue;
        }
        let fields = text
            .split_once(',')
            .map(|(name, stamp)| (name.trim(), stamp.trim()));
        let stamp =
            fields.and_then(|(_, stamp)| Duration::try_from_secs_f64(stamp.parse().ok()?).ok());
        let (Some((name, _)), Some(stamp)) = (fields, stamp) else {
            return wrong(format!(
                "a line is the name of a picture and its stamp in s, not `{text}`"
            ));
        };
        let path = folder.join(name);
        if !path.is_file() {
            return wrong(format!("there is no file `{}`", path.display()));
        }
        listed.push((path, Some(stamp)));
        if let Err(why) = ascending(
            listed
                .get(listed.len().saturating_sub(2)..)
                .unwrap_or_default(),
        ) {
            return wrong(why);
        }
    }
    Ok(listed)
}

/// A picture from a file.
fn opened(path: &Path) -> Result<Picture, String> {
    let shown = path.display();
    let about = fs::metadata(path).map_err(|error| format!("cannot read `{shown}`: {error}"))?;
    if !about.is_file() || about.len() > FILE_MOST {
        return Err(format!("`{shown}` is no file of up to {FILE_MOST} bytes"));
    }
    let bytes = fs::read(path).map_err(|error| format!("cannot read `{shown}`: {error}"))?;
    vss_image::read(&bytes).map_err(|why| format!("`{shown}`: {why}"))
}
