//! `/metrics` over HTTP, on the loopback only, in the process that boots. A chassis that does not answer is shown as
//! down.

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
use tokio::sync::Mutex;

use crate::{
    control::ask,
    doors::{OpenError, Pages},
};
use ctos_bootstrap::watch::{Gather, gather_here, page};
use ctos_core::{chassis::Chassis, system};

/// How long a chassis has to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Metrics that cannot be served.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot serve metrics at {address}: {error}; choose another `metrics.listen`, or leave it out"
)]
pub(crate) struct MetricsError {
    address: SocketAddr,
    error: OpenError,
}

/// Serves the metrics of the app at `address`, from within a tokio runtime, until that ends.
///
/// # Errors
/// When the address cannot be had.
pub(crate) fn serve(chassis: &Arc<Chassis>, address: SocketAddr) -> Result<(), MetricsError> {
    let failed = |error| MetricsError { address, error };
    let listener = TcpListener::bind(address).map_err(|error| failed(error.into()))?;
    let pages = Pages::new(listener, None, &[]).map_err(failed)?;
    tracing::info!(address = %pages.address(), "metrics are served");
    // One page is gathered at a time, however many ask.
    let home = Arc::new(Mutex::new(chassis.clone()));
    let service = service_fn(move |request| respond(request, home.clone()));
    tokio::spawn(async move {
        let Err(error) = pages.serve(service).await;
        tracing::error!(error = %error, "metrics are not served any more");
    });
    Ok(())
}

async fn gather(chassis: &Arc<Chassis>) -> String {
    let calls = chassis.others().map(async |index| {
        let agent = system::agent_tid(index);
        let answer = ask(chassis, agent, Gather {}, ANSWER_TIMEOUT).await;
        (chassis.name_of(index).to_owned(), answer.ok())
    });
    let mut answers = join_all(calls).await;
    answers.insert(0, (chassis.name().to_owned(), Some(gather_here(chassis))));
    page(chassis.clock.now().since_start().as_secs_f64(), &answers)
}

async fn respond(
    request: Request<Incoming>,
    home: Arc<Mutex<Arc<Chassis>>>,
) -> Result<Response<Full<Bytes>>, Infallible> {
    let (status, text) = if request.uri().path() != "/metrics" {
        (StatusCode::NOT_FOUND, "there is /metrics only\n".to_owned())
    } else if request.method() != Method::GET {
        (
            StatusCode::METHOD_NOT_ALLOWED,
            "metrics are read with GET\n".to_owned(),
        )
    } else {
        (StatusCode::OK, gather(&*home.lock().await).await)
    };
    let mut response = Response::new(Full::new(Bytes::from(text)));
    *response.status_mut() = status;
    let kind = hyper::header::HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
    response.headers_mut().insert(CONTENT_TYPE, kind);
    Ok(response)
}
