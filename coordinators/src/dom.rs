//! The Data Object Manager (DOM): data of the Coordination Level, by name, for everybody.
//!
//! Each object is tied to a place of a net that says whether it exists and is valid; the net tells the
//! DOM when tokens come to and leave that place (CIRSSE report 108, sections 6 and 7). An object that
//! its place calls invalid can still be read: its place is the guard, and a reader in a net fires only
//! when the place is marked.

use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
    sync::Arc,
};

use ctos::{
    message::{Command, CommandInfo, Message},
    registry::Registry,
    task::{Context, EventHandler, Handled, HandlerError},
};
use pnt::{
    library::{Acted, DataStore, Later},
    store::{Owner, Store},
};
use scene::FollowScene;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::drawn::Drawn;

/// The handler's name.
pub const HANDLER: &str = "coordinators.dom";

/// The commands it takes.
pub const COMMANDS: &[CommandInfo] = &[
    PutData::INFO,
    PutAll::INFO,
    GetData::INFO,
    SetValidity::INFO,
    ListData::INFO,
    FollowScene::INFO,
];

ctos::command! {
    /// Stores a data object.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct PutData {
        /// Its name.
        pub name: String,
        /// Its value, postcard.
        pub bytes: Vec<u8>,
    } => (), 0x0601, "put"
}
ctos::command! {
    /// Stores several data objects, all of them or none.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct PutAll {
        /// Their names, each of them once, and values, postcard.
        pub objects: Vec<(String, Vec<u8>)>,
    } => (), 0x0605, "put_all"
}
ctos::command! {
    /// Retrieves a data object.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct GetData {
        /// Its name.
        pub name: String,
    } => Vec<u8>, 0x0602, "get"
}
ctos::command! {
    /// Says whether the place that an object is tied to is marked.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct SetValidity {
        /// The object's name.
        pub name: String,
        /// Whether its place is marked.
        pub valid: bool,
    } => (), 0x0603, "set_validity"
}
ctos::command! {
    /// Lists all objects.
    #[derive(Debug, Clone, PartialEq, Eq)]
    pub struct ListData => Vec<DataObject>, 0x0604, "list"
}

/// An object as [`ListData`] shows it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataObject {
    /// Its name.
    pub name: String,
    /// Size of its value, bytes; `None` while it has none.
    pub bytes: Option<usize>,
    /// Whether its place is marked; `None` when no place is tied to it.
    pub valid: Option<bool>,
}

#[derive(Default, Deserialize)]
struct Entry {
    bytes: Option<Vec<u8>>,
    valid: Option<bool>,
}

/// The same, to be written.
#[derive(Serialize)]
struct Written<'e> {
    bytes: Option<&'e [u8]>,
    valid: Option<bool>,
}

/// The event handler.
#[derive(Default)]
pub struct Dom {
    objects: BTreeMap<String, Entry>,
    /// Where a durable one keeps them.
    store: Option<Arc<Store>>,
    /// What viewers see of them.
    drawn: Drawn,
}

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct DomArgs {
    /// Whether objects survive the process.
    durable: bool,
    /// The folder in which a durable one keeps them, relative to the configuration's folder.
    store: String,
}

impl Default for DomArgs {
    fn default() -> Self {
        Self {
            durable: false,
            store: "state".to_owned(),
        }
    }
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let handler = registry.handler(HANDLER, COMMANDS, Dom::from_args);
    handler.args::<DomArgs>();
}

impl Dom {
    /// A DOM as its task's arguments say; a durable one with the objects that it had.
    fn from_args(cx: &Context) -> Result<Self, HandlerError> {
        let args: DomArgs = cx.args()?;
        if !args.durable {
            return Ok(Self::default());
        }
        let owner = Owner {
            kind: "dom".to_owned(),
            name: cx.name().to_owned(),
        };
        let file = format!("{}.redb", cx.name());
        let store = Store::open(cx, &cx.path(&args.store).join(file), &owner)?;
        let mut objects = BTreeMap::new();
        for (name, bytes) in store.load(cx)? {
            let entry = postcard::from_bytes(&bytes).map_err(|error| {
                let path = store.path().display();
                HandlerError::new(format!("{path}: data object `{name}` is damaged: {error}"))
            })?;
            objects.insert(name, entry);
        }
        Ok(Self {
            objects,
            store: Some(store),
            drawn: Drawn::default(),
        })
    }

    /// Puts objects, all or none: they are looked at, then written through, and are there only then.
    async fn put(&mut self, cx: &Context, objects: Vec<(String, Vec<u8>)>) -> Handled {
        let mut names = BTreeSet::new();
        for (name, _) in &objects {
            if name.is_empty() {
                return Err(HandlerError::new("a data object needs a name"));
            }
            if !names.insert(name) {
                let text = format!("data object `{name}` is put twice at once");
                return Err(HandlerError::new(text));
            }
        }
        let written = objects.iter().map(|(name, bytes)| {
            let valid = self.objects.get(name).and_then(|entry| entry.valid);
            let bytes = Some(bytes.as_slice());
            (name.as_str(), Written { bytes, valid })
        });
        self.keep(cx, written).await?;
        for (name, bytes) in objects {
            self.drawn.put(&name, &bytes);
            self.objects.entry(name).or_default().bytes = Some(bytes);
        }
        Ok(())
    }

    /// Says whether an object is valid.
    async fn set_validity(&mut self, cx: &Context, name: String, valid: bool) -> Handled {
        let bytes = self.objects.get(&name);
        let written = Written {
            bytes: bytes.and_then(|entry| entry.bytes.as_deref()),
            valid: Some(valid),
        };
        self.keep(cx, std::iter::once((name.as_str(), written)))
            .await?;
        self.objects.entry(name).or_default().valid = Some(valid);
        Ok(())
    }

    /// Writes objects through, all or none, before anybody is told that they have changed.
    async fn keep<'e>(
        &self,
        cx: &Context,
        objects: impl Iterator<Item = (&'e str, Written<'e>)>,
    ) -> Handled {
        if let Some(store) = &self.store {
            let change = |(name, written): (&str, Written<'_>)| {
                Ok((name.to_owned(), Some(postcard::to_stdvec(&written)?)))
            };
            let changes = objects.map(change).collect::<Result<_, HandlerError>>()?;
            store.commit(cx, changes).await?;
        }
        Ok(())
    }
}

impl EventHandler for Dom {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            PutData::CODE => {
                let (PutData { name, bytes }, reply) = message.open::<PutData>()?;
                self.put(cx, vec![(name, bytes)]).await?;
                reply.ok(())
            }
            PutAll::CODE => {
                let (PutAll { objects }, reply) = message.open::<PutAll>()?;
                self.put(cx, objects).await?;
                reply.ok(())
            }
            GetData::CODE => {
                let (GetData { name }, reply) = message.open::<GetData>()?;
                match self
                    .objects
                    .get(&name)
                    .and_then(|entry| entry.bytes.clone())
                {
                    Some(bytes) => reply.ok(bytes),
                    None => reply.fail(format!("there is no data object `{name}`")),
                }
            }
            SetValidity::CODE => {
                let (SetValidity { name, valid }, reply) = message.open::<SetValidity>()?;
                self.set_validity(cx, name, valid).await?;
                reply.ok(())
            }
            ListData::CODE => {
                let (ListData {}, reply) = message.open::<ListData>()?;
                let list = self.objects.iter().map(|(name, entry)| DataObject {
                    name: name.clone(),
                    bytes: entry.bytes.as_ref().map(Vec::len),
                    valid: entry.valid,
                });
                reply.ok(list.collect())
            }
            FollowScene::CODE => {
                let objects = &self.objects;
                let value = |name: &str| objects.get(name)?.bytes.as_deref();
                self.drawn.follow(cx, message, value)
            }
            _ => cx.default_processing(message),
        }
    }
}

/// The DOM as nets and their functions use it.
#[derive(Debug, Clone)]
pub struct DomStore {
    task: Rc<str>,
}

impl DomStore {
    /// The DOM behind the task called `task`.
    #[must_use]
    pub fn new(task: &str) -> Self {
        Self { task: task.into() }
    }

    /// Stores a value.
    ///
    /// # Errors
    /// When the DOM cannot be reached.
    pub async fn store<T: Serialize>(&self, cx: &Context, name: &str, value: &T) -> Acted {
        let bytes = postcard::to_stdvec(value)?;
        let dom = cx.task(&self.task).await?;
        let name = name.to_owned();
        Ok(cx.call(&dom, PutData { name, bytes }).await?)
    }

    /// Retrieves a value.
    ///
    /// # Errors
    /// When the DOM has no such object, cannot be reached, or the object is of another type.
    pub async fn fetch<T: DeserializeOwned>(
        &self,
        cx: &Context,
        name: &str,
    ) -> Result<T, HandlerError> {
        let bytes = fetch_bytes(cx, &self.task, name).await?;
        typed(name, &bytes)
    }
}

/// A data object's value.
///
/// # Errors
/// It is of another type.
pub fn typed<T: DeserializeOwned>(name: &str, bytes: &[u8]) -> Result<T, HandlerError> {
    let another =
        |why: &str| HandlerError::new(format!("data object `{name}` is of another type: {why}"));
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        Ok((_, rest)) => Err(another(&format!("{} bytes too long", rest.len()))),
        Err(error) => Err(another(&error.to_string())),
    }
}

async fn fetch_bytes(cx: &Context, dom: &str, name: &str) -> Result<Vec<u8>, HandlerError> {
    let dom = cx.task(dom).await?;
    let name = name.to_owned();
    let answer = cx.call(&dom, GetData { name }).await;
    answer.map_err(|error| HandlerError::new(error.reason()))
}

impl DataStore for DomStore {
    fn get(&self, cx: &Context, object: &str) -> Later<Result<Vec<u8>, HandlerError>> {
        let (cx, dom, object) = (cx.clone(), self.task.clone(), object.to_owned());
        Box::pin(async move { fetch_bytes(&cx, &dom, &object).await })
    }

    fn put(&self, cx: &Context, objects: Vec<(String, Vec<u8>)>) -> Later<Acted> {
        let (cx, dom) = (cx.clone(), self.task.clone());
        Box::pin(async move {
            let dom = cx.task(&dom).await?;
            match <[_; 1]>::try_from(objects) {
                Ok([(name, bytes)]) => cx.call(&dom, PutData { name, bytes }).await?,
                Err(objects) => cx.call(&dom, PutAll { objects }).await?,
            }
            Ok(())
        })
    }

    fn validity(&self, cx: &Context, object: &str, valid: bool) -> Later<Acted> {
        let (cx, dom, name) = (cx.clone(), self.task.clone(), object.to_owned());
        Box::pin(async move {
            let dom = cx.task(&dom).await?;
            Ok(cx.call(&dom, SetValidity { name, valid }).await?)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use ctos::{registry::Registry, system::AppResult, task::Phase};
    use proptest::prelude::*;

    use super::*;
    use crate::rig;

    type Steps = Arc<Mutex<Vec<String>>>;

    /// Uses a DOM on another chassis and writes down what it says.
    struct User(Steps);

    impl EventHandler for User {
        async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
            cx.default_processing(message)
        }

        async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
            if phase == Phase::Run {
                let (child, steps) = (cx.clone(), self.0.clone());
                cx.spawn(async move {
                    let used = use_it(&child, &steps).await;
                    child.finish(AppResult {
                        ok: used.is_ok(),
                        text: used
                            .err()
                            .map_or_else(String::new, |error| error.to_string()),
                        json: String::new(),
                    });
                });
            }
            Ok(())
        }
    }

    async fn use_it(cx: &Context, steps: &Steps) -> Handled {
        let say = |step: String| steps.lock().unwrap().push(step);
        let dom = DomStore::new("dom");
        let unknown = dom.fetch::<u8>(cx, "path").await;
        say(unknown.unwrap_err().to_string());
        dom.validity(cx, "spots", true).await?;
        let valid_without_value = dom.fetch::<u8>(cx, "spots").await;
        say(valid_without_value.unwrap_err().to_string());
        dom.store(cx, "path", &(7_u8, "old".to_owned())).await?;
        dom.store(cx, "path", &(7_u8, "new".to_owned())).await?;
        dom.validity(cx, "path", true).await?;
        dom.validity(cx, "path", false).await?;
        let value: (u8, String) = dom.fetch(cx, "path").await?;
        say(format!("{value:?}"));
        say(dom.fetch::<u8>(cx, "path").await.unwrap_err().to_string());
        let longer = dom.fetch::<[f64; 16]>(cx, "path").await;
        say(longer.unwrap_err().to_string());
        let named = |name: &str, bytes: &[u8]| (name.to_owned(), bytes.to_vec());
        dom.put(cx, vec![named("bytes", &[1, 2, 3])]).await?;
        say(format!("{:?}", dom.get(cx, "bytes").await?));
        // The first two could be put by themselves.
        for bad in ["left", ""] {
            let several = vec![named("left", &[4]), named("bytes", &[5]), named(bad, &[6])];
            say(dom.put(cx, several).await.unwrap_err().to_string());
        }
        let task = cx.task("dom").await?;
        for DataObject { name, bytes, valid } in cx.call(&task, ListData {}).await? {
            say(format!("{name} {bytes:?} {valid:?}"));
        }
        let nobody = DomStore::new("nobody").fetch::<u8>(cx, "path").await;
        say(nobody.unwrap_err().to_string());
        Ok(())
    }

    #[test]
    fn objects_are_put_got_listed_and_told_apart_by_name_type_and_validity() {
        let text = "[app]\nname = \"t\"\nuntil = \"user\"\n[time]\nmode = \"virtual\"\n[chassis.a]\n[chassis.b]\n[task.user]\nhandler = \"user\"\non = \"a\"\n[task.dom]\nhandler = \"coordinators.dom\"\non = \"b\"\n";
        let folder = tempfile::tempdir().unwrap();
        let steps = Steps::default();
        let kept = steps.clone();
        let mut registry = Registry::new();
        crate::register(&mut registry);
        registry.handler("user", &[], move |_| Ok(User(kept.clone())));
        let world = rig::Shared::default();
        let end = rig::boot(rig::load(text, folder.path()), registry, &world);
        let mut steps = steps.lock().unwrap().clone();
        for (step, why, short) in [
            (6, "data object `left` is put twice at once", "TWICE"),
            (7, "a data object needs a name", "NAMELESS"),
        ] {
            assert!(steps[step].contains(why), "{steps:?}");
            steps[step] = short.to_owned();
        }
        let expected = [
            "there is no data object `path`",
            "there is no data object `spots`",
            "(7, \"new\")",
            "data object `path` is of another type: 4 bytes too long",
            "data object `path` is of another type: Hit the end of buffer, expected more data",
            "[1, 2, 3]",
            "TWICE",
            "NAMELESS",
            "bytes Some(3) None",
            "path Some(5) Some(false)",
            "spots None Some(true)",
        ];
        let (nobody, steps) = steps.split_last().unwrap();
        assert_eq!(steps, expected, "{end:?}");
        assert!(nobody.contains("no task is called `nobody`"), "{nobody}");
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_an_object_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = typed::<crate::objects::Spots>("spots", &bytes);
            let _ = typed::<crate::objects::Observations>("observations", &bytes);
        }
    }
}
