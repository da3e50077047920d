//! The services by which ROS 2's tools ask for a node's parameters and set them, on DDS. Answers are those of rclcpp:
//! a question about several parameters, one of which is not declared, has an empty answer.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow};
use mio::event::Source;
use mio::{Events, Interest, Poll, Token, Waker};
use ros2_client::parameters::raw;
use ros2_client::qos::History;
use ros2_client::rcl_interfaces::{
    DescribeParametersRequest, DescribeParametersResponse, GetParameterTypesRequest,
    GetParameterTypesResponse, GetParametersRequest, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, ListParametersResult, SetParametersAtomicallyResponse,
    SetParametersRequest, SetParametersResponse,
};
use ros2_client::{
    Message, Name, Node, NodeOptions, ParameterValue, QosProfile, Server, ServiceMapping,
    ServiceTypeName,
};

use super::dds::{LEAVES, Shared};
use super::queue::lock;
use crate::names::NodeName;
use crate::parameters::{Descriptor, Parameters, Range, Value};

/// Interval at which the thread of the services looks whether the node is still there.
const LOOK: Duration = Duration::from_millis(200);

/// Requests that wait at a service, as of ROS 2's parameter services.
const DEPTH: usize = 1000;

/// Requests that are answered in a row at one service.
const ROW: usize = 100;

/// Declares the parameters where the library announces changes of them.
pub(super) fn declare(options: NodeOptions, parameters: &Parameters) -> NodeOptions {
    let all = parameters.all().into_iter();
    all.fold(options, |options, (name, value)| {
        options.declare_parameter(&name, own(value))
    })
}

/// The services of one node.
pub(super) struct Services(Vec<Box<dyn Serve>>);

impl Services {
    /// Announces the services.
    pub(super) fn new(node: &mut Node, name: &NodeName) -> Result<Self> {
        let full = name.full();
        Ok(Self(vec![
            server(
                node,
                &full,
                "get_parameters",
                "GetParameters",
                |asked, request| get(asked.parameters, &request),
            )?,
            server(
                node,
                &full,
                "get_parameter_types",
                "GetParameterTypes",
                |asked, request| get_types(asked.parameters, &request),
            )?,
            server(
                node,
                &full,
                "describe_parameters",
                "DescribeParameters",
                |asked, request| describe(asked.parameters, &request),
            )?,
            server(
                node,
                &full,
                "list_parameters",
                "ListParameters",
                |asked, request| list(asked.parameters, &request),
            )?,
            server(node, &full, "set_parameters", "SetParameters", set)?,
            server(
                node,
                &full,
                "set_parameters_atomically",
                "SetParametersAtomically",
                set_atomically,
            )?,
        ]))
    }

    /// Serves in a thread, until the returned handle is dropped or the node has ended.
    pub(super) fn serve(
        mut self,
        node: &Shared,
        parameters: &Arc<Parameters>,
    ) -> Result<(JoinHandle<()>, End)> {
        let mut poll = Poll::new().context("starting the parameter services")?;
        let waker = Waker::new(poll.registry(), Token(usize::MAX));
        let end = End {
            is_over: Arc::default(),
            waker: waker.context("starting the parameter services")?,
        };
        let is_over = Arc::clone(&end.is_over);
        for (number, service) in self.0.iter_mut().enumerate() {
            let source = service.source();
            let registry = poll.registry();
            let registered = registry.register(source, Token(number), Interest::READABLE);
            registered.context("starting the parameter services")?;
        }
        let (node, parameters) = (Arc::downgrade(node), Arc::clone(parameters));
        let serve = move || {
            let mut events = Events::with_capacity(16);
            let mut latest = None;
            while node.strong_count() > 0 && !is_over.load(Ordering::Relaxed) {
                if let Err(error) = poll.poll(&mut events, Some(LOOK))
                    && error.kind() != std::io::ErrorKind::Interrupted
                {
                    return;
                }
                let asked = Asked {
                    parameters: &parameters,
                    node: &node,
                };
                // A wake-up may stand for several requests, and may have been missed.
                for service in &mut self.0 {
                    if service.answer(&asked) {
                        latest = Some(Instant::now());
                    }
                }
            }
            // The change that was answered last may be why the node ends.
            if let Some(latest) = latest {
                thread::sleep(LEAVES.saturating_sub(latest.elapsed()));
            }
        };
        let thread = thread::Builder::new().name("parameters".to_owned());
        let thread = thread
            .spawn(serve)
            .context("starting the thread of a node")?;
        Ok((thread, end))
    }
}

/// Ends the services when it is dropped.
pub(super) struct End {
    is_over: Arc<AtomicBool>,
    waker: Waker,
}

impl Drop for End {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        // Otherwise the thread finds out by itself, a little later.
        let _ = self.waker.wake();
    }
}

/// What a service is about.
struct Asked<'a> {
    parameters: &'a Parameters,
    node: &'a Weak<std::sync::Mutex<Node>>,
}

/// One service.
trait Serve: Send {
    fn source(&mut self) -> &mut dyn Source;

    /// Answers the requests that have arrived; returns whether there was one.
    fn answer(&mut self, asked: &Asked<'_>) -> bool;
}

struct Service<Q: Message, R: Message> {
    server: Server<Q, R>,
    answer: fn(&Asked<'_>, Q) -> R,
}

fn server<Q, R>(
    node: &mut Node,
    full: &str,
    name: &str,
    kind: &str,
    answer: fn(&Asked<'_>, Q) -> R,
) -> Result<Box<dyn Serve>>
where
    Q: Message + Clone + Send + 'static,
    R: Message + Send + 'static,
{
    let refused = |error: &dyn std::fmt::Debug| anyhow!("{full}/{name}: {error:?}");
    let qos = QosProfile {
        history: History::KeepLast { depth: DEPTH },
        ..QosProfile::publisher_default()
    };
    let service = Name::new(full, name).map_err(|error| refused(&error))?;
    let kind = ServiceTypeName::new("rcl_interfaces", kind);
    let server = node.create_server(ServiceMapping::Enhanced, &service, &kind, qos.clone(), qos);
    Ok(Box::new(Service {
        server: server.map_err(|error| refused(&error))?,
        answer,
    }))
}

impl<Q, R> Serve for Service<Q, R>
where
    Q: Message + Send + 'static,
    R: Message + Send + 'static,
{
    fn source(&mut self) -> &mut dyn Source {
        &mut self.server
    }

    fn answer(&mut self, asked: &Asked<'_>) -> bool {
        let mut has_answered = false;
        for _ in 0..ROW {
            match self.server.receive_request() {
                Ok(None) => break,
                Ok(Some((id, request))) => {
                    has_answered = true;
                    let answer = (self.answer)(asked, request);
                    // Whoever asked may be gone.
                    let _ = self.server.send_response(id, answer);
                }
                // Not a request: it cannot be answered.
                Err(_) => {}
            }
        }
        has_answered
    }
}

fn get(parameters: &Parameters, request: &GetParametersRequest) -> GetParametersResponse {
    let values = parameters.get(&request.names).unwrap_or_default();
    GetParametersResponse {
        values: values.into_iter().map(|value| own(value).into()).collect(),
    }
}

fn get_types(
    parameters: &Parameters,
    request: &GetParameterTypesRequest,
) -> GetParameterTypesResponse {
    let values = parameters.get(&request.names).unwrap_or_default();
    let kind = |value: Option<Value>| value.map_or(0, |value| value.kind() as u8);
    GetParameterTypesResponse {
        values: values.into_iter().map(kind).collect(),
    }
}

fn describe(
    parameters: &Parameters,
    request: &DescribeParametersRequest,
) -> DescribeParametersResponse {
    let described = parameters.describe(&request.names).unwrap_or_default();
    DescribeParametersResponse {
        values: described.into_iter().map(description).collect(),
    }
}

fn list(parameters: &Parameters, request: &ListParametersRequest) -> ListParametersResponse {
    let (names, prefixes) = parameters.list(&request.prefixes, request.depth);
    ListParametersResponse {
        result: ListParametersResult { names, prefixes },
    }
}

fn set(asked: &Asked<'_>, request: SetParametersRequest) -> SetParametersResponse {
    let each = request.parameter.into_iter();
    SetParametersResponse {
        results: each
            .map(|parameter| set_all(asked, vec![parameter]))
            .collect(),
    }
}

fn set_atomically(
    asked: &Asked<'_>,
    request: SetParametersRequest,
) -> SetParametersAtomicallyResponse {
    SetParametersAtomicallyResponse {
        result: set_all(asked, request.parameter),
    }
}

fn set_all(asked: &Asked<'_>, all: Vec<raw::Parameter>) -> raw::SetParametersResult {
    let changes: Vec<(String, Option<Value>)> = all
        .into_iter()
        .map(|parameter| (parameter.name, value_of(parameter.value)))
        .collect();
    let result = asked.parameters.set(&changes);
    if result.is_ok()
        && let Some(node) = asked.node.upgrade()
    {
        // Announces the changes on /parameter_events.
        for (name, value) in changes {
            let _ = lock(&node).set_parameter(&name, own(value));
        }
    }
    raw::SetParametersResult {
        successful: result.is_ok(),
        reason: result.err().unwrap_or_default(),
    }
}

/// Returns a value as the library has it.
fn own(value: Option<Value>) -> ParameterValue {
    match value {
        None => ParameterValue::NotSet,
        Some(Value::Bool(value)) => ParameterValue::Boolean(value),
        Some(Value::Integer(value)) => ParameterValue::Integer(value),
        Some(Value::Double(value)) => ParameterValue::Double(value),
        Some(Value::Text(text)) => ParameterValue::String(text),
        Some(Value::Bytes(bytes)) => ParameterValue::ByteArray(bytes),
        Some(Value::Bools(values)) => ParameterValue::BooleanArray(values),
        Some(Value::Integers(values)) => ParameterValue::IntegerArray(values),
        Some(Value::Doubles(values)) => ParameterValue::DoubleArray(values),
        Some(Value::Texts(texts)) => ParameterValue::StringArray(texts),
    }
}

/// Returns a value that was sent; `None` for one that is not set, and for an unknown type.
fn value_of(value: raw::ParameterValue) -> Option<Value> {
    Some(match ParameterValue::from(value) {
        ParameterValue::NotSet => return None,
        ParameterValue::Boolean(value) => Value::Bool(value),
        ParameterValue::Integer(value) => Value::Integer(value),
        ParameterValue::Double(value) => Value::Double(value),
        ParameterValue::String(text) => Value::Text(text),
        ParameterValue::ByteArray(bytes) => Value::Bytes(bytes),
        ParameterValue::BooleanArray(values) => Value::Bools(values),
        ParameterValue::IntegerArray(values) => Value::Integers(values),
        ParameterValue::DoubleArray(values) => Value::Doubles(values),
        ParameterValue::StringArray(texts) => Value::Texts(texts),
    })
}

fn description(descriptor: &Descriptor) -> raw::ParameterDescriptor {
    let (mut integer_range, mut floating_point_range) = (Vec::new(), Vec::new());
    match descriptor.range() {
        // A step of 0 stands for any step.
        Some(Range::Integer { from, to }) => integer_range.push(raw::IntegerRange {
            from_value: from,
            to_value: to,
            step: 0,
        }),
        Some(Range::Double { from, to }) => floating_point_range.push(raw::FloatingPointRange {
            from_value: from,
            to_value: to,
            step: 0.0,
        }),
        None => {}
    }
    raw::ParameterDescriptor {
        name: descriptor.name.clone(),
        r#type: descriptor.kind as u8,
        description: descriptor.description.clone(),
        additional_constraints: descriptor.constraints.clone(),
        read_only: descriptor.read_only,
        dynamic_typing: false,
        floating_point_range,
        integer_range,
    }
}
