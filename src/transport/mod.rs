//! Shared memory between the machine's motion controller and the service (iceoryx2).
//!
//! ```text
//! controller / lathe                                  service
//!   ServoPublisher  --- ServoBatch (1 per ms) --->    ServoSubscriber
//!   StatusPublisher --- TurretStatus (10+ per s) -->  StatusSubscriber
//!   CommandSubscriber <-- TurretCommand (<= 1 per s)  CommandPublisher (mode `act` only)
//! ```
//!
//! Ports belong to the operating-system thread that made them; nothing here knows of async tasks.

mod domain;
mod ports;
pub mod wire;

pub use domain::{Domain, JOIN_DEADLINE, Participant};
pub use ports::{
    COMMAND_SERVICE, CommandPublisher, CommandSubscriber, SERVO_SERVICE, STATUS_SERVICE, ServoPublisher,
    ServoSubscriber, StatusPublisher, StatusSubscriber,
};

use std::path::PathBuf;
use thiserror::Error;

/// Why shared memory cannot be used. One line.
#[derive(Debug, Error)]
pub enum TransportError {
    /// The domain's name or folder is not usable.
    #[error("{0}")]
    Domain(String),
    /// The domain's folder or lock cannot be used.
    #[error("{}: {source}; expected a folder that this user may write", path.display())]
    Files {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Another user holds a name of this domain in shared memory.
    #[error(
        "{}: belongs to user {owner}, and all of the domain must be of user {user}; remove it as that user \
         or root, or choose another transport.prefix",
        path.display()
    )]
    Foreign {
        /// File.
        path: PathBuf,
        /// Its owner.
        owner: u32,
        /// Whose domain it is.
        user: u32,
    },
    /// No node could be made.
    #[error("transport: cannot join the domain: {0}; all participants must run as the same user")]
    Join(String),
    /// Making a node did not end: a killed process left the domain unusable while others are in it.
    #[error("transport: joining {} did not end in 5 s; stop every participant, start again", root.display())]
    Wedged {
        /// Folder of the domain.
        root: PathBuf,
    },
    /// A port cannot be opened or used.
    #[error("transport: service {service}: {message}")]
    Port {
        /// Name of the iceoryx2 service.
        service: &'static str,
        /// What iceoryx2 said.
        message: String,
    },
}
