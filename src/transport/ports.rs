//! Typed ports of the three services of a domain.
//!
//! The servo stream overwrites its oldest batch when the reader stalls: a machine's producer must
//! never wait for us. Losses show as steps of `sequence` and are counted where they are read.

use super::TransportError;
use super::domain::Participant;
use super::wire::{ServoBatch, TurretCommand, TurretStatus};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::{BackpressureStrategy, ServiceName, ZeroCopySend, ipc};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use std::fmt::Debug;

/// Name of the service that carries [`ServoBatch`].
pub const SERVO_SERVICE: &str = "Stillcut/Servo";
/// Name of the service that carries [`TurretCommand`].
pub const COMMAND_SERVICE: &str = "Stillcut/TurretCommand";
/// Name of the service that carries [`TurretStatus`].
pub const STATUS_SERVICE: &str = "Stillcut/TurretStatus";

/// What is fixed by whoever creates a service; the same on all sides.
struct Quality {
    name: &'static str,
    buffer: usize,
    publishers: usize,
    subscribers: usize,
    history: usize,
}

// 1024 batches of one millisecond: a stall of a second loses nothing.
const SERVO: Quality =
    Quality { name: SERVO_SERVICE, buffer: 1024, publishers: 1, subscribers: 2, history: 0 };
const COMMAND: Quality =
    Quality { name: COMMAND_SERVICE, buffer: 16, publishers: 1, subscribers: 2, history: 0 };
const STATUS: Quality =
    Quality { name: STATUS_SERVICE, buffer: 64, publishers: 1, subscribers: 2, history: 1 };

fn service<T>(
    who: &Participant,
    quality: &Quality,
) -> Result<PortFactory<ipc::Service, T, ()>, TransportError>
where
    T: Debug + ZeroCopySend + 'static,
{
    let fail = |e: String| TransportError::Port { service: quality.name, message: e };
    let name: ServiceName = quality.name.try_into().map_err(|e| fail(format!("{e:?}")))?;
    let builder = who.node.service_builder(&name).publish_subscribe::<T>();
    builder
        .enable_safe_overflow(true)
        .subscriber_max_buffer_size(quality.buffer)
        .subscriber_max_borrowed_samples(2)
        .history_size(quality.history)
        .max_publishers(quality.publishers)
        .max_subscribers(quality.subscribers)
        .max_nodes(8)
        .open_or_create()
        .map_err(|e| fail(format!("{e:?}")))
}

fn publisher<T>(
    who: &Participant,
    quality: &Quality,
) -> Result<Publisher<ipc::Service, T, ()>, TransportError>
where
    T: Debug + ZeroCopySend + 'static,
{
    let fail = |e: String| TransportError::Port { service: quality.name, message: e };
    let factory = service::<T>(who, quality)?;
    let builder = factory.publisher_builder().backpressure_strategy(BackpressureStrategy::DiscardData);
    let port = builder.create().map_err(|e| match e {
        PublisherCreateError::ExceedsMaxSupportedPublishers => {
            let who = if quality.name == COMMAND_SERVICE { "service" } else { "producer" };
            fail(format!("another {who} runs in this domain; stop it first"))
        }
        e => fail(format!("{e:?}")),
    })?;
    port.update_connections().map_err(|e| fail(format!("{e:?}")))?;
    Ok(port)
}

fn subscriber<T>(
    who: &Participant,
    quality: &Quality,
) -> Result<Subscriber<ipc::Service, T, ()>, TransportError>
where
    T: Debug + ZeroCopySend + 'static,
{
    let fail = |e: String| TransportError::Port { service: quality.name, message: e };
    let factory = service::<T>(who, quality)?;
    factory.subscriber_builder().buffer_size(quality.buffer).create().map_err(|e| fail(format!("{e:?}")))
}

macro_rules! publishing_port {
    ($(#[$doc:meta])* $name:ident, $payload:ty, $quality:expr) => {
        $(#[$doc])*
        pub struct $name(Publisher<ipc::Service, $payload, ()>);

        impl $name {
            /// Opens the port, creating the service where it is not there yet.
            /// Errors: another publisher exists, or another layout or version does.
            pub fn open(who: &Participant) -> Result<Self, TransportError> {
                publisher(who, &$quality).map(Self)
            }

            /// Sends one; answers how many readers got it (0 is normal when nobody listens).
            pub fn send(&self, payload: &$payload) -> Result<usize, TransportError> {
                let fail = |e: String| TransportError::Port { service: $quality.name, message: e };
                let slot = self.0.loan_uninit().map_err(|e| fail(format!("{e:?}")))?;
                slot.write_payload(*payload).send().map_err(|e| fail(format!("{e:?}")))
            }
        }

        impl Debug for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(stringify!($name))
            }
        }
    };
}

macro_rules! subscribing_port {
    ($(#[$doc:meta])* $name:ident, $payload:ty, $quality:expr) => {
        $(#[$doc])*
        pub struct $name(Subscriber<ipc::Service, $payload, ()>);

        impl $name {
            /// Opens the port, creating the service where it is not there yet.
            /// Errors: too many readers, or another layout or version exists.
            pub fn open(who: &Participant) -> Result<Self, TransportError> {
                subscriber(who, &$quality).map(Self)
            }

            /// Hands everything that waits to `each`, oldest first, without copying; answers how many.
            /// A publisher that went away and came back is picked up by itself.
            pub fn drain(&self, mut each: impl FnMut(&$payload)) -> Result<usize, TransportError> {
                let mut count = 0;
                // More than one buffer's worth in one call means that the sender outruns us.
                while count < 2 * $quality.buffer {
                    let received = self.0.receive();
                    let fail = |e: String| TransportError::Port { service: $quality.name, message: e };
                    let Some(sample) = received.map_err(|e| fail(format!("{e:?}")))? else { break };
                    each(sample.payload());
                    count += 1;
                }
                Ok(count)
            }
        }

        impl Debug for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(stringify!($name))
            }
        }
    };
}

publishing_port!(
    /// The machine's side: servo samples out.
    ServoPublisher, ServoBatch, SERVO
);
subscribing_port!(
    /// The service's side: servo samples in.
    ServoSubscriber, ServoBatch, SERVO
);
publishing_port!(
    /// The service's side: turret commands out. Exists in mode `act` only.
    CommandPublisher, TurretCommand, COMMAND
);
subscribing_port!(
    /// The machine's side: turret commands in.
    CommandSubscriber, TurretCommand, COMMAND
);
publishing_port!(
    /// The machine's side: what the turret does.
    StatusPublisher, TurretStatus, STATUS
);
subscribing_port!(
    /// The service's side: what the turret does.
    StatusSubscriber, TurretStatus, STATUS
);
