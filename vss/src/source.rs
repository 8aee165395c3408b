//! Frame sources: what a Vision Module takes pictures with. The seam to simulators, files and real cameras,
//! which register here under a name and are otherwise unknown to this crate.

pub mod kinds;

use std::{collections::BTreeMap, sync::Arc};

use ctos::{
    config::Node,
    diagnostic::{Finding, Findings},
    registry::unread_args,
    task::{Context, HandlerError},
};
use futures_util::future::LocalBoxFuture;

use crate::frame::{Frame, FrameError};

/// Something that takes pictures. It may ask other tasks and wait for them.
pub trait FrameSource {
    /// Whether it takes pictures of what is now, by a sensor: then their stamps are of the app's clock, and no two have the
    /// same pixels. A Vision Module watches such a source for more.
    fn is_live(&self) -> bool {
        false
    }

    /// Takes one picture.
    fn snap<'a>(&'a mut self, cx: &'a Context) -> LocalBoxFuture<'a, Result<Frame, FrameError>>;
}

type Build =
    Arc<dyn Fn(&Context, &str, &Node) -> Result<Box<dyn FrameSource>, HandlerError> + Send + Sync>;
type Check = Box<dyn Fn(&str, &Node, &mut Findings) + Send + Sync>;

/// A kind of frame source.
pub struct SourceKind {
    build: Build,
    check: Option<Check>,
    keys: Vec<&'static str>,
}

impl SourceKind {
    /// Declares the keys of a camera's arguments that a source without a [`check`](Self::check) reads. Any other key is found
    /// before anything starts.
    pub fn keys(&mut self, keys: &[&'static str]) -> &mut Self {
        self.keys.extend(keys);
        self
    }

    /// Adds a check of a camera's arguments that runs before anything starts. It gets the camera's name and the
    /// arguments, and finds the keys that the source does not know, too.
    pub fn check(
        &mut self,
        check: impl Fn(&str, &Node, &mut Findings) + Send + Sync + 'static,
    ) -> &mut Self {
        self.check = Some(Box::new(check));
        self
    }
}

/// Every kind of frame source that a program offers, by name.
#[derive(Default)]
pub struct FrameSources {
    kinds: BTreeMap<String, SourceKind>,
}

impl FrameSources {
    /// No kinds.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Registers a kind of source. `build` gets the Vision Module's context, the camera's name and the arguments
    /// `[vss.cameras.NAME.args]`; it must not ask other tasks yet. A later registration of the same name
    /// replaces the earlier one.
    pub fn source(
        &mut self,
        name: &str,
        build: impl Fn(&Context, &str, &Node) -> Result<Box<dyn FrameSource>, HandlerError>
        + Send
        + Sync
        + 'static,
    ) -> &mut SourceKind {
        let kind = SourceKind {
            build: Arc::new(build),
            check: None,
            keys: Vec::new(),
        };
        match self.kinds.entry(name.to_owned()) {
            std::collections::btree_map::Entry::Occupied(mut there) => {
                there.insert(kind);
                there.into_mut()
            }
            std::collections::btree_map::Entry::Vacant(free) => free.insert(kind),
        }
    }

    pub(crate) fn build(
        &self,
        source: &str,
        cx: &Context,
        camera: &str,
        args: &Node,
    ) -> Result<Box<dyn FrameSource>, HandlerError> {
        match self.kinds.get(source) {
            Some(kind) => (kind.build)(cx, camera, args),
            None => Err(HandlerError::new(self.unknown(source).to_string())),
        }
    }

    /// Checks that `source` is known and takes `args`.
    pub(crate) fn check(&self, source: &Node, camera: &str, args: &Node, findings: &mut Findings) {
        let name = source.as_str().unwrap_or_default();
        match self.kinds.get(name) {
            Some(SourceKind {
                check: Some(check), ..
            }) => check(camera, args, findings),
            Some(kind) => unread_args(
                args,
                &kind.keys,
                args.place().or(source.place()),
                |key| {
                    format!("camera `{camera}` gives `args.{key}`, and its frame source `{name}`")
                },
                "the source reads where it is registered: `sources.source(..).keys(..)`, or `check`",
                findings,
            ),
            None => {
                let finding = self.unknown(name);
                findings.push(match source.place() {
                    Some(place) => finding.at(place.clone()),
                    None => finding,
                });
            }
        }
    }

    fn unknown(&self, name: &str) -> Finding {
        Finding::error(
            "vss::source::unknown",
            format!("no frame source is called `{name}`"),
        )
        .suggest(name, self.kinds.keys().map(String::as_str))
    }
}

impl std::fmt::Debug for FrameSources {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.kinds.keys()).finish()
    }
}
