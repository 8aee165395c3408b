//! The metrics of an app as Prometheus reads them.

mod server;
mod text;

pub(crate) use server::serve;

#[cfg(test)]
mod tests;
