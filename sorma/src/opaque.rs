//! The untyped bytes of a transport structure: a buffer of its own, or memory that others have too.
//!
//! What an object writes here is its own, and the memory stays for the next call. What came from another process is
//! read where it stands, and what goes to another process is lent to it (see [`ctos::Blob`]). So a picture passes
//! through any number of proxies without being copied.

use ctos::Blob;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::ops::Deref;

/// Bytes, for example an image. They are read as a slice; a writer gets a copy of its own if others
/// have them too.
#[derive(Default)]
pub struct Opaque {
    own: Vec<u8>,
    /// What stands in place of its own.
    shared: Option<Blob>,
}

impl Opaque {
    /// Empties it and keeps its memory, if that is its own.
    pub fn clear(&mut self) {
        self.own.clear();
        self.shared = None;
    }

    /// The bytes, to be changed; a copy if others have them too.
    pub fn to_mut(&mut self) -> &mut Vec<u8> {
        if let Some(blob) = self.shared.take() {
            // Without a copy where nobody else has them.
            self.own = blob.into();
        }
        &mut self.own
    }

    /// Adds bytes at the end.
    pub fn extend_from_slice(&mut self, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.to_mut().extend_from_slice(bytes);
        }
    }

    /// The same in memory of their own, to be kept: bytes that another process has lent keep some of its memory.
    #[must_use]
    pub fn to_own(&self) -> Self {
        self.to_vec().into()
    }

    /// Lets others have the bytes too, from now on without a copy.
    pub fn share(&mut self) {
        if !self.own.is_empty() && self.shared.is_none() {
            self.shared = Some(std::mem::take(&mut self.own).into());
        }
    }
}

impl Clone for Opaque {
    fn clone(&self) -> Self {
        Self {
            own: self.own.clone(),
            shared: self.shared.clone(),
        }
    }

    fn clone_from(&mut self, other: &Self) {
        // What is its own keeps its memory.
        self.own.clone_from(&other.own);
        self.shared.clone_from(&other.shared);
    }
}

impl Deref for Opaque {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.shared {
            Some(blob) => blob,
            None => &self.own,
        }
    }
}

impl AsRef<[u8]> for Opaque {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

impl fmt::Debug for Opaque {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Opaque({} bytes)", self.len())
    }
}

impl<T: AsRef<[u8]> + ?Sized> PartialEq<T> for Opaque {
    fn eq(&self, other: &T) -> bool {
        **self == *other.as_ref()
    }
}

impl From<Vec<u8>> for Opaque {
    fn from(own: Vec<u8>) -> Self {
        Self { own, shared: None }
    }
}

impl From<Blob> for Opaque {
    fn from(blob: Blob) -> Self {
        Self {
            own: Vec::new(),
            shared: Some(blob),
        }
    }
}

impl From<Opaque> for Blob {
    fn from(opaque: Opaque) -> Self {
        opaque.shared.unwrap_or_else(|| opaque.own.into())
    }
}

impl FromIterator<u8> for Opaque {
    fn from_iter<I: IntoIterator<Item = u8>>(bytes: I) -> Self {
        bytes.into_iter().collect::<Vec<u8>>().into()
    }
}

impl Serialize for Opaque {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.shared {
            Some(blob) => blob.serialize(serializer),
            // As a whole and not one by one, which takes a hundred times as long.
            None => serializer.serialize_bytes(&self.own),
        }
    }
}

impl<'de> Deserialize<'de> for Opaque {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let blob = Blob::deserialize(deserializer)?;
        Ok(if blob.is_empty() {
            Self::default()
        } else {
            blob.into()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, Clone)]
    enum Step {
        Add(Vec<u8>),
        Share,
        Clear,
        Own,
        Wire,
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            prop::collection::vec(any::<u8>(), 0..100).prop_map(Step::Add),
            Just(Step::Share),
            Just(Step::Clear),
            Just(Step::Own),
            Just(Step::Wire),
        ];
        prop::collection::vec(step, 0..20)
    }

    proptest! {
        #[test]
        fn it_is_a_vector_of_bytes_whoever_else_has_them(steps in steps()) {
            let (mut opaque, mut bytes) = (Opaque::default(), Vec::new());
            let mut before = Vec::new();
            for step in steps {
                before.push((opaque.clone(), bytes.clone()));
                match step {
                    Step::Add(more) => {
                        opaque.extend_from_slice(&more);
                        bytes.extend(more);
                    }
                    Step::Share => opaque.share(),
                    Step::Clear => {
                        opaque.clear();
                        bytes.clear();
                    }
                    Step::Own => opaque = opaque.to_own(),
                    Step::Wire => {
                        let wire = postcard::to_allocvec(&opaque).unwrap();
                        prop_assert_eq!(&wire, &postcard::to_allocvec(&bytes).unwrap());
                        opaque = postcard::from_bytes(&wire).unwrap();
                    }
                }
                prop_assert_eq!(&opaque, &bytes);
            }
            for (opaque, bytes) in before {
                prop_assert_eq!(opaque, bytes);
            }
        }
    }

    #[test]
    fn what_is_cleared_keeps_its_memory_and_what_is_shared_is_not_copied() {
        let mut opaque = Opaque::from(vec![1; 1000]);
        opaque.clear();
        assert!(opaque.to_mut().capacity() >= 1000);
        opaque.extend_from_slice(&[7; 50]);
        opaque.share();
        let other = opaque.clone();
        assert_eq!(opaque.as_ptr(), other.as_ptr());
        opaque.to_mut().push(1);
        assert_eq!((opaque.len(), other.len()), (51, 50));
    }
}
