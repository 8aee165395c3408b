//! A person who guides an arm by hand: takes hold of a link, pulls it along a straight line, lets go, and tells whether the arm
//! came along and stayed there.
//!
//! The arm needs a law that gives way, as `cartesian_impedance` without a spring. Knows the arm by its client interface alone.

use std::time::Duration;

use ctos::{
    Context,
    message::{Command, Message},
    registry::Registry,
    system::AppResult,
    task::{EventHandler, Handled, HandlerError, Phase, TaskRef},
};
use mcs::client::{Acquire, MotionError, Move, PathKind, ReadPosition, Release, Target};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;

use crate::world_task::{HandThere, HoldLink};

/// Name of the event handler.
pub const GUIDE: &str = "sim.guide";

/// How often the person moves the hand.
const PERIOD: Duration = Duration::from_micros(4500);
/// How long the hand rests at the end before it lets go, and how long what it left may still move.
const RESTS: Duration = Duration::from_secs(1);
/// A motion is answered at its end.
const DEADLINE: Duration = Duration::from_secs(60);

/// Arguments of the handler.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuideArgs {
    /// The task that owns the world.
    #[serde(default = "crate::source::world_task")]
    pub world: String,
    /// The client interface of the arm.
    #[serde(default = "client")]
    pub client: String,
    /// The arm in the cell; the only one, when none is named.
    pub arm: Option<String>,
    /// The frame of its model that the hand holds.
    pub link: String,
    /// How far and which way, m in the world.
    pub way: [f64; 3],
    /// How long that takes, s.
    #[serde(default = "takes_s")]
    pub takes_s: f64,
    /// How stiff the hand is, N/m, and how much it damps, N s/m.
    #[serde(default = "stiffness")]
    pub stiffness: f64,
    /// N s/m.
    #[serde(default = "damping")]
    pub damping: f64,
    /// It pulls no harder, N.
    #[serde(default = "most_n")]
    pub most_n: f64,
    /// For how long it looks whether the arm stays, s.
    #[serde(default = "stays_s")]
    pub stays_s: f64,
    /// How far the link may end from where the hand left it, and come off the line, m.
    #[serde(default = "within_m")]
    pub within_m: f64,
}

fn client() -> String {
    "mcs".to_owned()
}

fn takes_s() -> f64 {
    4.0
}

fn stiffness() -> f64 {
    1000.0
}

fn damping() -> f64 {
    50.0
}

fn most_n() -> f64 {
    40.0
}

fn stays_s() -> f64 {
    10.0
}

fn within_m() -> f64 {
    0.005
}

/// Registers the event handler.
pub(crate) fn register(registry: &mut Registry) {
    registry
        .handler(GUIDE, &[], |cx| Ok(Guide(cx.args()?)))
        .args::<GuideArgs>();
}

struct Guide(GuideArgs);

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Guided {
    /// How far the link came along the line, m.
    along: f64,
    /// How far it was off the line at most, m.
    off: f64,
    /// How hard the hand pulled at most, N.
    pulled: f64,
    /// How far it moved in the second after the hand let go, and after that, m.
    coasted: f64,
    drifted: f64,
}

/// From 0 to 1 in a time of 1, with neither speed nor acceleration at both ends.
fn smooth(time: f64) -> f64 {
    let time = time.clamp(0.0, 1.0);
    time * time * time * (10.0 + time * (6.0 * time - 15.0))
}

impl Guide {
    /// Moves the hand, or lets go; where the link is.
    async fn hand(
        &self,
        cx: &Context,
        world: &TaskRef,
        at: Option<Point3<f64>>,
    ) -> Result<Point3<f64>, HandlerError> {
        let hold = HoldLink {
            arm: self.0.arm.clone(),
            link: self.0.link.clone(),
            hand: at.map(|at| HandThere {
                at: at.coords.into(),
                stiffness: self.0.stiffness,
                damping: self.0.damping,
                most_n: self.0.most_n,
            }),
        };
        Ok(cx.call(world, hold).await?.into())
    }

    async fn guide(&self, cx: &Context) -> Result<Guided, HandlerError> {
        let (world, client) = (
            cx.task(&self.0.world).await?,
            cx.task(&self.0.client).await?,
        );
        asked(cx, &client, Acquire {}).await?;
        let joints = cx.call(&client, ReadPosition {}).await?.commanded;
        // Its brakes open with its first motion, which goes nowhere.
        let nowhere = Move {
            target: Target::Joints(joints),
            path: PathKind::Joint,
            speed: 0.1,
            acceleration: None,
            elbow: None,
            blend: 0.0.into(),
            guards: Vec::new(),
        };
        asked(cx, &client, nowhere).await?;
        let way = Vector3::from(self.0.way);
        let line = way
            .try_normalize(1e-6)
            .ok_or("`way` has no length; say how far the hand goes, m")?;
        let start = self.hand(cx, &world, None).await?;
        let mut guided = Guided::default();
        let began = cx.now();
        loop {
            let time = cx.now().since(began).as_secs_f64();
            let hand = start + way * smooth(time / self.0.takes_s);
            let there = self.hand(cx, &world, Some(hand)).await?;
            let came = there - start;
            let off = (came - line * came.dot(&line)).norm();
            let pulled = ((hand - there).norm() * self.0.stiffness).min(self.0.most_n);
            guided.off = guided.off.max(off);
            guided.pulled = guided.pulled.max(pulled);
            if time > self.0.takes_s + RESTS.as_secs_f64() {
                break;
            }
            cx.sleep(PERIOD).await;
        }
        let left = self.hand(cx, &world, None).await?;
        guided.along = (left - start).dot(&line);
        cx.sleep(RESTS).await;
        let rests = self.hand(cx, &world, None).await?;
        cx.sleep(Duration::from_secs_f64(self.0.stays_s)).await;
        let stays = self.hand(cx, &world, None).await?;
        (guided.coasted, guided.drifted) = ((rests - left).norm(), (stays - rests).norm());
        asked(cx, &client, Release {}).await?;
        Ok(guided)
    }

    fn result(&self, guided: Result<Guided, HandlerError>) -> AppResult {
        let guided = match guided {
            Ok(guided) => guided,
            Err(error) => {
                return AppResult {
                    ok: false,
                    text: error.to_string(),
                    json: String::new(),
                };
            }
        };
        let Guided {
            along,
            off,
            pulled,
            coasted,
            drifted,
        } = guided;
        let far = Vector3::from(self.0.way).norm();
        let short = (far - along).abs();
        AppResult {
            ok: [short, off, coasted, drifted]
                .iter()
                .all(|distance| *distance <= self.0.within_m),
            text: format!(
                "`{}` came along by {:.1} of {:.1} mm, at most {:.1} mm off the line, pulled with at most {pulled:.1} N; left alone \
                 it moved by {:.2} mm in 1 s, and by {:.2} mm in the {} s after",
                self.0.link,
                along * 1e3,
                far * 1e3,
                off * 1e3,
                coasted * 1e3,
                drifted * 1e3,
                self.0.stays_s,
            ),
            json: format!(
                "{{\"along_m\":{along:?},\"off_m\":{off:?},\"pulled_n\":{pulled:?},\"coasted_m\":{coasted:?},\"drifted_m\":{drifted:?}}}"
            ),
        }
    }
}

async fn asked<T, C: Command<Reply = Result<T, MotionError>>>(
    cx: &Context,
    client: &TaskRef,
    request: C,
) -> Result<T, HandlerError> {
    Ok(cx.call(client, request).deadline(DEADLINE).await??)
}

impl EventHandler for Guide {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        cx.default_processing(message)
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase == Phase::Run {
            let (own, guide) = (cx.clone(), Self(self.0.clone()));
            cx.spawn(async move {
                let guided = guide.guide(&own).await;
                own.finish(guide.result(guided));
            });
        }
        Ok(())
    }
}
