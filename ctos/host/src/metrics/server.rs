//! `/metrics` over HTTP, on the loopback only, in the process that boots.
//!
//! The server runs on the boot's sockets; what it shows is gathered by the runtime's own processor,
//! which asks the agents of all chassis. An agent that does not answer is shown as down.

use std::{
    convert::Infallible,
    net::{SocketAddr, TcpListener},
    sync::Arc,
    time::Duration,
};

use futures_util::future::join_all;
use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode, body::Bytes, body::Incoming, header::CONTENT_TYPE,
    service::service_fn,
};
use tokio::sync::{mpsc, oneshot};

use super::text::{Answers, page};
use crate::doors::{OpenError, Pages};
use ctos_bootstrap::watch::{Gather, gather_here};
use ctos_core::{
    chassis::Chassis,
    context::{Context, TaskRef},
    system,
    task_record::TaskRecord,
};
use ctos_message::Tid;

/// How long an agent has to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// How many clients may wait for the next page.
const CLIENTS: usize = 16;
/// In whose name the agents are asked: no task has this id, and nobody is answered at it but by call.
const ASKER: Tid = Tid::new(0, 0, u16::MAX);

/// Metrics that cannot be served.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot serve metrics at {address}: {error}; choose another `metrics.listen`, or leave it out"
)]
pub(crate) struct MetricsError {
    address: SocketAddr,
    error: OpenError,
}

type Ask = oneshot::Sender<String>;

/// Serves the metrics of the app at `address`, from within a tokio runtime, until that ends.
///
/// # Errors
/// When the address cannot be had.
pub(crate) async fn serve(
    chassis: &Arc<Chassis>,
    address: SocketAddr,
) -> Result<SocketAddr, MetricsError> {
    let failed = |error| MetricsError { address, error };
    let listener = TcpListener::bind(address).map_err(|error| failed(error.into()))?;
    let pages = Pages::new(listener, None, &[]).map_err(failed)?;
    let bound = pages.address();
    let (asks, asked) = mpsc::channel(CLIENTS);
    let home = chassis.clone();
    if let Some((_, processor)) = chassis.processors.first() {
        processor.inject(move |processor| {
            let asker = TaskRecord::of_runtime("metrics", ASKER, Arc::default(), &processor.handle);
            let cx = Context::new(asker, home, processor.clone(), None);
            processor.spawn(answer(cx, asked), None);
        });
    }
    let service = service_fn(move |request| respond(request, asks.clone()));
    tokio::spawn(async move {
        let Err(error) = pages.serve(service).await;
        tracing::error!(error = %error, "metrics are not served any more");
    });
    tracing::info!(address = %bound, "metrics are served");
    Ok(bound)
}

/// Gathers a page for each that asks.
async fn answer(cx: Context, mut asked: mpsc::Receiver<Ask>) {
    while let Some(ask) = asked.recv().await {
        let page = gather(&cx).await;
        // A client that went away needs none.
        let _ = ask.send(page);
    }
}

async fn gather(cx: &Context) -> String {
    let calls = cx.chassis().others().map(|index| {
        let name = cx.chassis().name_of(index).to_owned();
        let agent = TaskRef::new(format!("agent@{name}"), system::agent_tid(index));
        let call = cx.call(&agent, Gather {}).deadline(ANSWER_TIMEOUT);
        async move { (name, call.await.ok()) }
    });
    let mut answers: Answers = vec![(
        cx.chassis().name().to_owned(),
        Some(gather_here(cx.chassis())),
    )];
    answers.extend(join_all(calls).await);
    page(cx.now().since_start().as_secs_f64(), &answers)
}

async fn respond(
    request: Request<Incoming>,
    asks: mpsc::Sender<Ask>,
) -> Result<Response<Full<Bytes>>, Infallible> {
    let (status, text) = if request.uri().path() != "/metrics" {
        (StatusCode::NOT_FOUND, "there is /metrics only\n".to_owned())
    } else if request.method() != Method::GET {
        (
            StatusCode::METHOD_NOT_ALLOWED,
            "metrics are read with GET\n".to_owned(),
        )
    } else {
        let (sender, answer) = oneshot::channel();
        // Both fail only when the app is ending.
        let asked = asks.send(sender).await.is_ok();
        match answer.await {
            Ok(page) if asked => (StatusCode::OK, page),
            _ => (
                StatusCode::SERVICE_UNAVAILABLE,
                "the app is ending\n".to_owned(),
            ),
        }
    };
    let mut response = Response::new(Full::new(Bytes::from(text)));
    *response.status_mut() = status;
    let kind = hyper::header::HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
    response.headers_mut().insert(CONTENT_TYPE, kind);
    Ok(response)
}
