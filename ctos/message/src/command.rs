//! Commands: the typed requests that tasks take, and what is known of them without their types.

use serde::{Serialize, de::DeserializeOwned};

use crate::{
    PayloadError,
    fields::{fields_of, split},
    shape::{Shape, kept},
};

pub use ctos_derive::Command;

/// A request that a task takes: its data, its code, its name and the type of its reply. Derived:
///
/// ```
/// use ctos::message::Command;
/// use serde::{Deserialize, Serialize};
///
/// /// Greets somebody.
/// #[derive(Serialize, Deserialize, Command)]
/// #[command(reply = String, code = 0x0001)]
/// struct Greet {
///     name: String,
/// }
/// assert_eq!((Greet::NAME, Greet::DOC), ("greet", "Greets somebody."));
/// ```
///
/// [`command!`](crate::command) says the same on one line.
pub trait Command: Serialize + DeserializeOwned + Send + 'static {
    /// What the task answers.
    type Reply: Serialize + DeserializeOwned + Send + 'static;
    /// Code in the header; unique among the commands of one handler and below [`SYSTEM_COMMANDS`].
    const CODE: u16;
    /// Name in nets, text and logs.
    const NAME: &'static str;
    /// One line of help.
    const DOC: &'static str;
    /// The description that a handler registers.
    const INFO: CommandInfo = CommandInfo {
        code: Self::CODE,
        name: Self::NAME,
        doc: Self::DOC,
        request: DataType::of::<Self>(),
        reply: DataType::of::<Self::Reply>(),
    };
}

/// Codes from here on belong to the runtime.
pub const SYSTEM_COMMANDS: u16 = 0xff00;

/// The one command of the runtime that follows requests on a link; the others have credits of their own.
pub const FENCE: u16 = 0xff6a;

/// What is known of a command without its types.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CommandInfo {
    /// Code in the header.
    pub code: u16,
    /// Name in nets, text and logs.
    pub name: &'static str,
    /// One line of help.
    pub doc: &'static str,
    /// The type of a request.
    pub request: DataType,
    /// The type of a reply.
    pub reply: DataType,
}

impl CommandInfo {
    /// A command that a program in another language declares. What is declared stays for as long as this process lives.
    /// Its help is to tell the types, too: two that differ in them are different commands.
    #[must_use]
    pub fn declared(code: u16, name: &str, doc: &str, request: Shape, reply: Shape) -> Self {
        Self {
            code,
            name: kept::text(name),
            doc: kept::text(doc),
            request: DataType(Of::Declared(kept::shape(request))),
            reply: DataType(Of::Declared(kept::shape(reply))),
        }
    }
}

type Split = fn(&[u8]) -> Result<Vec<Vec<u8>>, PayloadError>;

/// A type of data, for programs that do not know it and have the postcard bytes of its values.
#[derive(Clone, Copy, derive_more::Debug)]
#[debug("DataType")]
pub struct DataType(Of);

#[derive(Clone, Copy)]
enum Of {
    /// One of this program.
    Compiled {
        shape: fn() -> Option<Shape>,
        fields: fn() -> usize,
        split: Split,
    },
    /// One that a program in another language declares.
    Declared(&'static Shape),
}

impl DataType {
    /// For values of type `T`.
    #[must_use]
    pub const fn of<T: DeserializeOwned>() -> Self {
        Self(Of::Compiled {
            shape: Shape::of::<T>,
            fields: fields_of::<T>,
            split: split::<T>,
        })
    }

    /// What its values look like, where that can be found: by it they become JSON.
    #[must_use]
    pub fn shape(self) -> Option<Shape> {
        match self.0 {
            Of::Compiled { shape, .. } => shape(),
            Of::Declared(shape) => Some(shape.clone()),
        }
    }

    /// How many fields the type has: a structure or a tuple those that it declares, a unit none, and any other
    /// type is one.
    #[must_use]
    pub fn fields(self) -> usize {
        match self.0 {
            Of::Compiled { fields, .. } => fields(),
            Of::Declared(shape) => shape.fields(),
        }
    }

    /// The postcard bytes of each field of a value, in order.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub fn split(self, bytes: &[u8]) -> Result<Vec<Vec<u8>>, PayloadError> {
        match self.0 {
            Of::Compiled { split, .. } => split(bytes),
            Of::Declared(shape) => shape.split(bytes).ok_or_else(|| PayloadError {
                expected: "value of the declared type",
                reason: format!("{} bytes are no such value", bytes.len()),
            }),
        }
    }
}

/// Code, name and documentation say what a command is; the types of its data follow from them.
impl PartialEq for DataType {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for DataType {}

/// Declares typed commands: each request with its documentation, `=>` its reply, code and name. With `all NAME;`
/// in front, `NAME` is the list of them.
///
/// ```
/// ctos::command! {
///     /// Greets somebody.
///     pub struct Greet { pub name: String } => String, 0x0001, "greet"
/// }
/// # use ctos::message::Command;
/// assert_eq!(Greet::DOC, "Greets somebody.");
/// ```
#[macro_export]
macro_rules! command {
    (all $all:ident; $(
        $(#[$($meta:tt)+])+
        $vis:vis struct $name:ident $({ $($fields:tt)* })? => $reply:ty, $code:expr, $text:literal;
    )+) => {
        /// All the commands that are declared together with it.
        pub const $all: &[$crate::CommandInfo] = &[$(<$name as $crate::Command>::INFO),+];

        $crate::command! { $(
            $(#[$($meta)+])+
            $vis struct $name $({ $($fields)* })? => $reply, $code, $text;
        )+ }
    };
    ($(
        $(#[doc = $doc:literal])+
        $(#[derive($($derive:path),* $(,)?)])?
        $vis:vis struct $name:ident $({ $($(#[$field_meta:meta])* $field_vis:vis $field:ident : $type:ty),* $(,)? })?
        => $reply:ty, $code:expr, $text:literal $(;)?
    )+) => {$(
        $(#[doc = $doc])+
        #[derive($crate::serde::Serialize, $crate::serde::Deserialize $(, $($derive),*)?)]
        #[serde(crate = "ctos::serde")]
        $vis struct $name { $($($(#[$field_meta])* $field_vis $field : $type),*)? }

        impl $crate::Command for $name {
            type Reply = $reply;
            const CODE: u16 = $code;
            const NAME: &'static str = $text;
            const DOC: &'static str = $crate::trimmed(concat!($($doc),+));
        }
    )+};
}

/// Drops the blank that rustdoc leaves in front of a documentation line.
#[doc(hidden)]
#[must_use]
pub const fn trimmed(text: &'static str) -> &'static str {
    match text.as_bytes() {
        [b' ', ..] => text.split_at(1).1,
        _ => text,
    }
}
