//! What the endings of a net's firings send to other nets: made once for a net, since every firing of a
//! transition sends the same.

use std::{collections::BTreeMap, rc::Rc, sync::Arc};

use super::messages::Transfer;
use pnt_language::net::{Net, Outputs, TransitionId};

/// To one net: tokens of one firing travel together.
pub(super) struct Route {
    pub(super) net: Arc<str>,
    pub(super) transfer: Arc<Transfer>,
}

/// What one ending of a firing sends.
pub(super) type Bundle = Rc<[Route]>;

/// What a transition sends when it has fired, and when its action has failed.
struct OfTransition {
    fired: Bundle,
    failed: Bundle,
}

/// What every transition of a net sends.
pub(super) struct Routes(Vec<OfTransition>);

impl Routes {
    pub(super) fn new(net: &Net) -> Self {
        let mut names = BTreeMap::new();
        let mut bundle = |outputs| bundle(outputs, &mut names);
        let of = net.transitions().iter().map(|transition| OfTransition {
            fired: bundle(&transition.outputs),
            failed: transition
                .fail
                .as_ref()
                .map(&mut bundle)
                .unwrap_or_default(),
        });
        Self(of.collect())
    }

    /// What a firing sends that ended so.
    pub(super) fn of(&self, id: TransitionId, failed: bool) -> Option<Bundle> {
        let of = self.0.get(id.index())?;
        let bundle = if failed { &of.failed } else { &of.fired };
        (!bundle.is_empty()).then(|| Rc::clone(bundle))
    }
}

/// `names` are those of the nets so far, so that each has one only.
fn bundle<'n>(outputs: &'n Outputs, names: &mut BTreeMap<&'n str, Arc<str>>) -> Bundle {
    let mut per_net: BTreeMap<&str, Transfer> = BTreeMap::new();
    for arc in &outputs.remote {
        let transfer = per_net.entry(&arc.net).or_default();
        transfer.tokens.push((arc.place.clone(), arc.weight));
    }
    let routes = per_net.into_iter().map(|(net, transfer)| Route {
        net: Arc::clone(names.entry(net).or_insert_with(|| net.into())),
        transfer: Arc::new(transfer),
    });
    routes.collect()
}
