//! One value of any type that can be sent, small ones in place: the data of a message without an
//! allocation. It knows nothing of messages.
//!
//! # Safety
//!
//! This is the only module of the message path with `unsafe`. Its argument: a [`Parcel`] is made for
//! one type `T` by [`Parcel::new`], which stores the value, or a pointer to it, in `words` together
//! with the [`Kind`] of that `T`. The words therefore hold what the kind says until the value leaves, in
//! one of three ways: [`Parcel::take`] moves it out and forgets the parcel, [`Parcel::take_out`] moves it out
//! and makes the parcel one of `()`, which needs no word, or the parcel is dropped, which drops it once.
//! Nothing else writes words or kind. Moving a parcel moves the value bytewise, as every move in Rust does.
//! A parcel is `Send` because every `T` in one is; it is not `Sync`, and shared access goes through
//! `&dyn Payload` only, which is bound to the borrow.

#![allow(
    unsafe_code,
    reason = "a value of any type in place, without an allocation: see the argument above"
)]

use std::{
    any::TypeId,
    mem::{ManuallyDrop, MaybeUninit},
};

use crate::message::Payload;

/// Values of up to this many bytes, aligned as `u64` at most, are kept in place.
pub const INLINE_BYTES: usize = 64;

type Words = [MaybeUninit<u64>; INLINE_BYTES / 8];

/// What a parcel holds, and where.
struct Kind {
    id: TypeId,
    /// In the words, or behind the pointer in the first of them.
    in_place: bool,
    /// The value of a parcel of this kind, by its words.
    value: unsafe fn(*mut Words) -> *mut dyn Payload,
}

/// Whether values of a type are kept in place.
const fn is_small<T>() -> bool {
    size_of::<T>() <= INLINE_BYTES && align_of::<T>() <= align_of::<u64>()
}

struct KindOf<T>(std::marker::PhantomData<T>);

impl<T: Payload> KindOf<T> {
    const KIND: Kind = Kind {
        id: TypeId::of::<T>(),
        in_place: is_small::<T>(),
        value: Self::value,
    };

    /// # Safety
    /// `words` are those of a live parcel of this kind.
    unsafe fn value(words: *mut Words) -> *mut dyn Payload {
        if is_small::<T>() {
            words.cast::<T>()
        } else {
            // SAFETY: `Parcel::new` wrote a pointer to a boxed `T` to the first word.
            unsafe { words.cast::<*mut T>().read() }
        }
    }
}

/// A value of one type among all that can be sent. In this order, so that who looks for its type brings over
/// the cache line that most of the value is in.
#[repr(C)]
pub struct Parcel {
    words: Words,
    kind: &'static Kind,
}

// SAFETY: the value is a `Payload`, which is `Send`.
unsafe impl Send for Parcel {}

impl Parcel {
    /// Packs `value`.
    #[inline]
    pub fn new<T: Payload>(value: T) -> Self {
        let mut parcel = Self {
            words: [const { MaybeUninit::uninit() }; INLINE_BYTES / 8],
            kind: const { &KindOf::<T>::KIND },
        };
        let words = (&raw mut parcel.words).cast::<T>();
        if is_small::<T>() {
            // SAFETY: the words are as large as `T` and as strictly aligned, and `parcel` owns them.
            unsafe { words.write(value) };
        } else {
            let boxed = Box::into_raw(Box::new(value));
            // SAFETY: a pointer is one word.
            unsafe { words.cast::<*mut T>().write(boxed) };
        }
        parcel
    }

    /// The value, if it is a `T`; else the parcel as it was.
    ///
    /// # Errors
    /// The parcel itself, when it holds another type.
    #[inline]
    pub fn take<T: 'static>(self) -> Result<T, Self> {
        if self.kind.id != TypeId::of::<T>() {
            return Err(self);
        }
        let mut parcel = ManuallyDrop::new(self);
        let words = (&raw mut parcel.words).cast::<T>();
        if is_small::<T>() {
            // SAFETY: the id says that the words hold a `T`; the parcel is never dropped, so it is
            // read once.
            Ok(unsafe { words.read() })
        } else {
            // SAFETY: the id says that the first word is the pointer that `Box::into_raw` gave for a
            // `T`; the parcel is never dropped, so the box is made anew once.
            Ok(*unsafe { Box::from_raw(words.cast::<*mut T>().read()) })
        }
    }

    /// The value, if it is a `T`, from where it stands: what is left there is a parcel of nothing.
    #[inline]
    pub(crate) fn take_out<T: 'static>(&mut self) -> Option<T> {
        if self.kind.id != TypeId::of::<T>() {
            return None;
        }
        self.kind = const { &KindOf::<()>::KIND };
        let words = (&raw mut self.words).cast::<T>();
        if is_small::<T>() {
            // SAFETY: the id said that the words hold a `T`; from here on the parcel is one of `()`,
            // which needs no word, so the `T` is read once.
            Some(unsafe { words.read() })
        } else {
            // SAFETY: as above, with the pointer that `Box::into_raw` gave for a `T`.
            Some(*unsafe { Box::from_raw(words.cast::<*mut T>().read()) })
        }
    }

    /// Looks at what it holds, and does nothing with it.
    #[inline]
    pub(crate) fn glance(&self) {
        std::hint::black_box(self.kind);
    }

    /// The value, whatever its type.
    #[must_use]
    pub fn payload(&self) -> &dyn Payload {
        let words = (&raw const self.words).cast_mut();
        // SAFETY: the words are those of this live parcel. The pointer is only read through, and the
        // value lives, unmoved and unchanged, as long as the borrow.
        unsafe { &*(self.kind.value)(words) }
    }
}

impl Drop for Parcel {
    fn drop(&mut self) {
        // SAFETY: the words are those of this parcel, which is live until the end of this call and
        // not used after it.
        unsafe {
            let value = (self.kind.value)(&raw mut self.words);
            if self.kind.in_place {
                std::ptr::drop_in_place(value);
            } else {
                drop(Box::from_raw(value));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;
    use serde::Serialize;

    use super::*;

    /// Counts its owners, and is as large as told.
    #[derive(Serialize)]
    struct Counted<const BYTES: usize> {
        #[serde(skip)]
        _owner: Arc<()>,
        #[serde(skip)]
        filling: [u8; BYTES],
    }

    /// How a value leaves its parcel.
    #[derive(Debug, Clone, Copy)]
    enum Leave {
        Taken,
        TakenOut,
        Dropped,
    }

    fn is_dropped_once<const BYTES: usize>(filling: u8, leave: Leave) {
        let owners = Arc::new(());
        let parcel = Parcel::new(Counted {
            _owner: owners.clone(),
            filling: [filling; BYTES],
        });
        assert_eq!(Arc::strong_count(&owners), 2);
        // Through a heap, so that it is moved for real.
        let moved = std::hint::black_box(Box::new([parcel]));
        let [parcel] = *moved;
        let parcel = parcel.take::<u64>().expect_err("it is not a number");
        let value = match leave {
            Leave::Taken => parcel.take::<Counted<BYTES>>().ok(),
            Leave::TakenOut => {
                let mut parcel = parcel;
                assert!(parcel.take_out::<u64>().is_none(), "it is not a number");
                let value = parcel.take_out::<Counted<BYTES>>();
                assert!(parcel.take_out::<Counted<BYTES>>().is_none(), "it is out");
                assert_eq!(parcel.take::<()>().ok(), Some(()));
                value
            }
            Leave::Dropped => {
                drop(parcel);
                None
            }
        };
        assert_eq!(value.is_none(), matches!(leave, Leave::Dropped));
        if let Some(value) = value {
            assert_eq!(value.filling, [filling; BYTES]);
            assert_eq!(Arc::strong_count(&owners), 2);
        }
        assert_eq!(Arc::strong_count(&owners), 1);
    }

    #[derive(Serialize)]
    #[repr(align(32))]
    struct Aligned(u8);

    proptest! {
        #[test]
        fn every_value_comes_out_whole_or_is_dropped_once(
            filling: u8,
            leave in prop_oneof![Just(Leave::Taken), Just(Leave::TakenOut), Just(Leave::Dropped)],
        ) {
            is_dropped_once::<0>(filling, leave);
            is_dropped_once::<1>(filling, leave);
            is_dropped_once::<56>(filling, leave);
            is_dropped_once::<57>(filling, leave);
            is_dropped_once::<1000>(filling, leave);
        }
    }

    #[test]
    fn alignment_and_encoding_hold_in_place_and_boxed() {
        let aligned = Parcel::new(Aligned(7));
        assert_eq!(aligned.payload().encode().unwrap(), [7]);
        assert_eq!(aligned.take::<Aligned>().ok().map(|it| it.0), Some(7));
        assert_eq!(Parcel::new([1_u8; 3]).payload().encode().unwrap(), [1; 3]);
        assert_eq!(Parcel::new(()).take::<()>().ok(), Some(()));
    }

    #[test]
    fn parcels_cross_threads() {
        let parcels: Vec<Parcel> = (0..1000)
            .map(|number: u64| match number % 2 {
                0 => Parcel::new(number),
                _ => Parcel::new([number; 20]),
            })
            .collect();
        let sum = std::thread::spawn(move || {
            let values = parcels
                .into_iter()
                .map(|parcel| match parcel.take::<u64>() {
                    Ok(number) => number,
                    Err(parcel) => parcel.take::<[u64; 20]>().map_or(0, |array| array[19]),
                });
            values.sum::<u64>()
        });
        assert_eq!(sum.join().unwrap(), (0..1000).sum::<u64>());
    }
}
