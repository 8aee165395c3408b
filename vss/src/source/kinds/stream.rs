//! Pictures one after the other from a file or a named pipe.

use std::{
    fs::File,
    io::{BufReader, Read},
    os::unix::fs::FileTypeExt as _,
    path::{Path, PathBuf},
    thread,
};

use ctos::{Context, task::HandlerError};
use futures_util::future::LocalBoxFuture;
use serde::Deserialize;
use tokio::sync::mpsc;
use vss_image::{
    Format, Picture,
    stream::{Kind, Stream},
};

use super::{Args, Camera, seconds, stamp};
use crate::{
    frame::{Frame, FrameError},
    source::FrameSource,
};

/// So many pictures wait for their reader; more wait in the pipe, and so does who writes it.
const WAITING: usize = 2;

/// What the stream is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum StreamFormat {
    Png,
    Pnm,
    Raw,
}

/// What a pixel of a raw stream is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum RawPixel {
    #[default]
    Grey8,
    Rgb8,
}

/// Arguments of `vss.stream`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StreamArgs {
    /// The file or pipe, relative to the configuration's folder.
    path: String,
    format: StreamFormat,
    /// Of a raw picture, px.
    width: Option<usize>,
    /// Of a raw picture, px.
    height: Option<usize>,
    /// Of a raw picture.
    pixel: Option<RawPixel>,
    /// Time between two pictures, s.
    period_s: Option<f64>,
    /// How long each exposure was, s.
    #[serde(default)]
    exposure_s: f64,
}

impl StreamArgs {
    fn kind(&self) -> Result<Kind, String> {
        match (self.format, self.width, self.height) {
            (StreamFormat::Raw, Some(width @ 1..), Some(height @ 1..)) => Ok(Kind::Raw {
                width,
                height,
                format: match self.pixel.unwrap_or_default() {
                    RawPixel::Grey8 => Format::Grey8,
                    RawPixel::Rgb8 => Format::Rgb8,
                },
            }),
            (StreamFormat::Raw, ..) => {
                Err("raw pictures need `width` and `height`, 1 px or more".to_owned())
            }
            _ if self.width.or(self.height).is_some() || self.pixel.is_some() => Err(
                "`width`, `height` and `pixel` are those of raw pictures; others say their own"
                    .to_owned(),
            ),
            (StreamFormat::Png, ..) => Ok(Kind::Png),
            (StreamFormat::Pnm, ..) => Ok(Kind::Pnm),
        }
    }
}

impl Args for StreamArgs {
    fn wrong(&self) -> Option<String> {
        let period = self
            .period_s
            .map_or(Ok(()), |period| seconds("period_s", period).map(drop));
        let wrong = self.kind().map(drop).and(period);
        wrong
            .and(seconds("exposure_s", self.exposure_s).map(drop))
            .err()
    }
}

type Pictures = Stream<BufReader<Box<dyn Read + Send>>>;

/// Where pictures come from.
enum Origin {
    /// In a replay nothing is opened.
    Nowhere,
    /// A file, which is read when it is asked.
    File(Box<Pictures>),
    /// A pipe, which a thread reads: who writes it may take its time.
    Pipe(mpsc::Receiver<Result<Picture, String>>),
}

/// A stream of pictures.
pub(super) struct PictureStream {
    camera: Camera,
    args: StreamArgs,
    path: PathBuf,
    from: Origin,
}

impl PictureStream {
    pub(super) fn new(cx: &Context, camera: &str, args: StreamArgs) -> Result<Self, HandlerError> {
        let path = cx.path(&args.path);
        let kind = args.kind().map_err(HandlerError::new)?;
        let from = if cx.is_replay() {
            Origin::Nowhere
        } else {
            opened(&path, kind).map_err(|error| {
                HandlerError::new(format!(
                    "cannot read the stream `{}`: {error}",
                    path.display()
                ))
            })?
        };
        Ok(Self {
            camera: Camera::new(camera),
            args,
            path,
            from,
        })
    }

    async fn take(&mut self, cx: &Context) -> Result<Frame, FrameError> {
        let what = "the next picture of a stream";
        let read = match &mut self.from {
            Origin::Pipe(pictures) => {
                let next = async {
                    let picture = pictures.recv().await.transpose()?;
                    framed(&mut self.camera, &self.args, picture)
                };
                cx.outside_wait(what, next).await
            }
            Origin::File(pictures) => cx.outside(what, || {
                let picture = pictures
                    .next()
                    .transpose()
                    .map_err(|error| error.to_string())?;
                framed(&mut self.camera, &self.args, picture)
            }),
            Origin::Nowhere => cx.outside(what, || Ok(None)),
        };
        let at = |why: &str| format!("`{}`: {why}", self.path.display());
        let frame = read.map_err(|why| self.camera.fault(at(&why)))?;
        let mut frame = frame.ok_or_else(|| self.camera.fault(at("the stream has ended")))?;
        frame.stamp = stamp(cx, self.args.period_s, frame.number);
        Ok(frame)
    }
}

fn framed(
    camera: &mut Camera,
    args: &StreamArgs,
    picture: Option<Picture>,
) -> Result<Option<Frame>, String> {
    let exposure = seconds("exposure_s", args.exposure_s)?;
    Ok(picture.map(|picture| camera.frame(picture, std::time::Duration::ZERO, exposure)))
}

/// Opens the stream. A pipe is opened by its thread, which waits there until somebody writes it.
fn opened(path: &Path, kind: Kind) -> std::io::Result<Origin> {
    let about = std::fs::metadata(path)?;
    if !about.file_type().is_fifo() {
        let file: Box<dyn Read + Send> = Box::new(File::open(path)?);
        return Ok(Origin::File(Box::new(Stream::new(
            BufReader::new(file),
            kind,
        ))));
    }
    let (to, pictures) = mpsc::channel(WAITING);
    let path = path.to_owned();
    // The thread ends with the stream, or at the next picture after its reader has ended.
    thread::Builder::new()
        .name("stream".to_owned())
        .spawn(move || {
            let file = match File::open(&path) {
                Ok(file) => file,
                Err(error) => return drop(to.blocking_send(Err(error.to_string()))),
            };
            for picture in Stream::new(BufReader::new(file), kind) {
                if to
                    .blocking_send(picture.map_err(|error| error.to_string()))
                    .is_err()
                {
                    return;
                }
            }
        })?;
    Ok(Origin::Pipe(pictures))
}

impl FrameSource for PictureStream {
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>> {
        Box::pin(self.take(cx))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn a_pipe_is_read_as_it_is_written_and_ends_with_its_writer() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pictures");
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.unwrap().success());
        let Origin::Pipe(mut pictures) = opened(&path, Kind::Pnm).unwrap() else {
            panic!("a pipe is no file");
        };
        let mut to = File::options().write(true).open(&path).unwrap();
        for grey in [b"P5 1 1 255\n1", b"P5 1 1 255\n2"] {
            to.write_all(grey).unwrap();
            let picture = pictures.blocking_recv().unwrap().unwrap();
            assert_eq!(picture.pixels, &grey[11..]);
        }
        to.write_all(b"P5 2 1 255\n1").unwrap();
        drop(to);
        let error = pictures.blocking_recv().unwrap().unwrap_err();
        assert!(error.contains("picture 2 of the stream"), "{error}");
        assert!(pictures.blocking_recv().is_none());
    }
}
