//! The commands of `ctos` on running apps, a file each, and the progress of an app as its boot tells it. They ask an app
//! over its control socket; none of them knows what an app is made of.

pub mod logs;
pub mod move_task;
pub mod progress;
pub mod ps;
pub mod record;
pub mod restart;
pub mod status;
pub mod stop;
pub mod top;
