//! Values by the names of nets. A name is mostly the very string that came before, not only one that reads the
//! same. The nets are few, so a look-up compares the strings' addresses first.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// In the order of the names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ByNet<T>(Vec<(Arc<str>, T)>);

impl<T> Default for ByNet<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> ByNet<T> {
    /// Where a net is, or would be.
    #[inline]
    fn index(&self, net: &Arc<str>) -> Result<usize, usize> {
        let mut names = self.0.iter().map(|(name, _)| name);
        let same = names.position(|name| Arc::ptr_eq(name, net));
        same.map_or_else(|| self.index_by_text(net), Ok)
    }

    /// Apart from what is looked for first, which is short enough to be inlined without it.
    #[inline(never)]
    fn index_by_text(&self, net: &str) -> Result<usize, usize> {
        self.0.binary_search_by(|(name, _)| (**name).cmp(net))
    }

    /// What belongs to a net, if there is anything.
    #[inline]
    pub(super) fn get(&self, net: &Arc<str>) -> Option<&T> {
        let index = self.index(net).ok()?;
        self.0.get(index).map(|(_, value)| value)
    }

    /// The nets, with what belongs to each.
    pub(super) fn iter(&self) -> impl Iterator<Item = &(Arc<str>, T)> {
        self.0.iter()
    }
}

impl<T: Default> ByNet<T> {
    /// What belongs to a net, made where there was nothing.
    #[inline]
    pub(super) fn of(&mut self, net: &Arc<str>) -> &mut T {
        let index = self.index(net).unwrap_or_else(|index| {
            self.add(index, net);
            index
        });
        &mut self.0[index].1
    }

    #[cold]
    fn add(&mut self, index: usize, net: &Arc<str>) {
        self.0.insert(index, (Arc::clone(net), T::default()));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn a_net_is_found_by_the_text_of_its_name_too_and_nets_are_in_the_order_of_names() {
        let mut numbers: ByNet<u32> = ByNet::default();
        let b: Arc<str> = "b".into();
        *numbers.of(&b) += 1;
        *numbers.of(&"a".into()) += 10;
        *numbers.of(&"c".into()) += 100;
        *numbers.of(&"b".into()) += 1;
        *numbers.of(&b) += 1;
        assert_eq!(numbers.get(&b), Some(&3));
        assert_eq!(numbers.get(&"c".into()), Some(&100));
        assert_eq!(numbers.get(&"d".into()), None);
        assert!(numbers.iter().map(|(net, _)| &**net).eq(["a", "b", "c"]));
    }

    #[test]
    fn it_is_stored_as_a_map_is() {
        let map = BTreeMap::from([("b", 1_u32), ("a", 10)]);
        let stored = postcard::to_stdvec(&map).unwrap();
        let numbers: ByNet<u32> = postcard::from_bytes(&stored).unwrap();
        assert_eq!(numbers.get(&"a".into()), Some(&10));
        assert_eq!(postcard::to_stdvec(&numbers).unwrap(), stored);
    }
}
