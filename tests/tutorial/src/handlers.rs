//! The event handlers of tea.

use std::time::Duration;

use ctos::{
    message::Command,
    registry::Registry,
    task::{Context, HandlerError},
};
use serde::{Deserialize, Serialize};

/// Boils the water of one cup.
#[derive(Serialize, Deserialize, Command)]
#[command(code = 0x0001)]
struct Boil {}

/// Fills the kettle.
#[derive(Serialize, Deserialize, Command)]
#[command(code = 0x0002)]
struct Fill {}

/// Holds water for so many cups.
struct Kettle(u32);

#[ctos::handler]
impl Kettle {
    #[command]
    async fn boil(&mut self, cx: &Context, _: Boil) -> Result<(), HandlerError> {
        self.0 = self.0.checked_sub(1).ok_or("the kettle is empty")?;
        cx.sleep(Duration::from_secs(2)).await;
        Ok(())
    }

    #[command]
    fn fill(&mut self, _: Fill) {
        self.0 = 2;
    }
}

/// Every event handler that `app.toml` can name: those of `ctos`, and the kettle.
pub fn registry() -> Registry {
    let mut registry = cli::program::registry();
    registry.handler("tea.kettle", &Kettle::COMMANDS, |_| Ok(Kettle(2)));
    registry
}
