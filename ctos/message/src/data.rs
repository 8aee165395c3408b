//! The data of a message: a value inside a chassis, postcard bytes between chassis.

use std::any::Any;

use serde::{Serialize, de::DeserializeOwned};
use smallbox::{SmallBox, smallbox};

use crate::blob::{self, Body};

/// A value that can move as it is and be encoded when it must leave the chassis.
pub trait Payload: Send {
    /// Appends the postcard bytes to `buffer`; after an error part of them may be there.
    ///
    /// # Errors
    /// When the value cannot be serialized.
    fn encode_into(&self, buffer: &mut Vec<u8>) -> Result<(), PayloadError>;

    /// Moves the value to `place`, if that is an `Option` of its type.
    fn move_to(&mut self, place: &mut dyn Any);
}

/// A value until it is moved out.
struct Held<T>(Option<T>);

impl<T: Serialize + Send + 'static> Payload for Held<T> {
    fn encode_into(&self, buffer: &mut Vec<u8>) -> Result<(), PayloadError> {
        self.0
            .iter()
            .try_for_each(|value| append(value, buffer).map_err(PayloadError::of::<T>))
    }

    #[inline]
    fn move_to(&mut self, place: &mut dyn Any) {
        if let Some(place) = place.downcast_mut::<Option<T>>()
            && let Some(value) = self.0.take()
        {
            *place = Some(value);
        }
    }
}

/// Appends the postcard bytes of `value` to `buffer`.
pub fn append<T: Serialize + ?Sized>(
    value: &T,
    buffer: &mut Vec<u8>,
) -> Result<(), postcard::Error> {
    postcard::serialize_with_flavor(value, Appending(buffer))
}

/// A postcard output that appends to a buffer of somebody else's.
struct Appending<'a>(&'a mut Vec<u8>);

impl postcard::ser_flavors::Flavor for Appending<'_> {
    type Output = ();

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.0.push(byte);
        Ok(())
    }

    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        if !blob::collect(self.0.len(), bytes) {
            self.0.extend_from_slice(bytes);
        }
        Ok(())
    }

    fn finalize(self) -> postcard::Result<()> {
        Ok(())
    }
}

/// Data that is not what the receiver expects.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("data is not a {expected}: {reason}")]
pub struct PayloadError {
    /// The type that was expected.
    pub expected: &'static str,
    /// Why the data is not one.
    pub reason: String,
}

impl PayloadError {
    /// Data is not a `T`, and why.
    pub(super) fn of<T: ?Sized>(reason: impl ToString) -> Self {
        Self {
            expected: std::any::type_name::<T>(),
            reason: reason.to_string(),
        }
    }

    /// What follows a `T` and should not.
    pub(super) fn too_long<T>(rest: &[u8]) -> Self {
        Self::of::<T>(format_args!("{} bytes too many", rest.len()))
    }
}

/// Reads exactly one `T`.
pub(super) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, PayloadError> {
    match postcard::take_from_bytes::<T>(bytes) {
        Ok((value, [])) => Ok(value),
        Ok((_, rest)) => Err(PayloadError::too_long::<T>(rest)),
        Err(error) => Err(PayloadError::of::<T>(error)),
    }
}

/// Values of up to 64 bytes stand in the message itself: an allocation costs more than to move them.
type Inline = [u64; 9];

/// The data of a message: a typed value inside a chassis, bytes from another one.
#[derive(derive_more::Debug)]
pub enum Data {
    /// A value of the sender's.
    #[debug("Typed(..)")]
    Typed(SmallBox<dyn Payload, Inline>),
    /// Postcard bytes.
    #[debug("Bytes({})", _0.len())]
    Bytes(Vec<u8>),
}

impl Data {
    /// No bytes.
    pub const NOTHING: Self = Self::Bytes(Vec::new());

    /// Data that moves `value`.
    #[inline]
    pub fn of<T: Serialize + Send + 'static>(value: T) -> Self {
        Self::Typed(smallbox!(Held(Some(value))))
    }

    /// The value, moved out or decoded.
    ///
    /// # Errors
    /// When the value is of another type, or the bytes do not decode to exactly one `T`.
    #[inline]
    pub fn take<T: DeserializeOwned + 'static>(mut self) -> Result<T, PayloadError> {
        self.take_out()
    }

    /// [`Self::take`] where the data stands; what is left means nothing.
    ///
    /// # Errors
    /// As [`Self::take`].
    #[inline]
    pub fn take_out<T: DeserializeOwned + 'static>(&mut self) -> Result<T, PayloadError> {
        match self {
            Self::Typed(value) => {
                let mut place = None;
                value.move_to(&mut place);
                place.ok_or_else(|| PayloadError::of::<T>("the sender passed another type"))
            }
            Self::Bytes(bytes) => blob::read_from(std::mem::take(bytes), decode::<T>),
        }
    }

    /// Appends the bytes that would go on the wire to `buffer`; the data stays.
    ///
    /// # Errors
    /// When a typed value cannot be encoded.
    pub fn append_to(&self, buffer: &mut Vec<u8>) -> Result<(), PayloadError> {
        match self {
            Self::Typed(value) => value.encode_into(buffer),
            Self::Bytes(bytes) => {
                buffer.extend_from_slice(bytes);
                Ok(())
            }
        }
    }

    /// The bytes to put on the wire.
    ///
    /// # Errors
    /// When a typed value cannot be encoded.
    pub fn into_bytes(self) -> Result<Vec<u8>, PayloadError> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            typed @ Self::Typed(_) => typed.to_bytes(),
        }
    }
}

impl From<Body> for Data {
    fn from(body: Body) -> Self {
        Self::Bytes(body.into_vec())
    }
}

impl Data {
    /// What goes to a link; large blobs in it are shared, not copied.
    ///
    /// # Errors
    /// When a typed value cannot be encoded.
    pub fn into_body(self) -> Result<Body, PayloadError> {
        match self {
            Self::Bytes(bytes) => Ok(bytes.into()),
            typed @ Self::Typed(_) => blob::body_of(|| typed.into_bytes()),
        }
    }

    /// The bytes that would be put on the wire; the data stays.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PayloadError> {
        /// Most messages are no larger, bytes; a larger one moves when it grows.
        const USUAL: usize = 128;
        let mut bytes = Vec::with_capacity(USUAL);
        self.append_to(&mut bytes)?;
        Ok(bytes)
    }
}
