//! Parameters over DDS, asked for and set as ROS 2's tools do.

use std::net::{IpAddr, Ipv4Addr};
use std::time::{Duration, Instant};

use eecvs_ros::message::{EventPacket, Image, Message as _, from_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::dds::Dds;
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::parameters::raw;
use ros2_client::rcl_interfaces::{
    DescribeParametersRequest, DescribeParametersResponse, GetParameterTypesRequest,
    GetParameterTypesResponse, GetParametersRequest, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, SetParametersAtomicallyResponse, SetParametersRequest,
    SetParametersResponse,
};
use ros2_client::{
    Context, Message, MessageTypeName, Name, Node, NodeOptions, ParameterValue, QosProfile,
    ServiceMapping, ServiceTypeName,
};

use crate::pipeline::{Network, emulated};
use crate::program::{PATIENCE, Program, QOS};

/// A client of a node's parameters.
struct Client {
    node: Node,
    of: String,
}

impl Client {
    fn new(domain: u16, of: &str) -> Self {
        let participant = DomainParticipantBuilder::new(domain)
            .with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)])
            .build();
        let context = Context::from_domain_participant(participant.unwrap()).unwrap();
        let name = ros2_client::NodeName::new("/", "client").unwrap();
        let options = NodeOptions::new().enable_rosout(false);
        Self {
            node: context.new_node(name, options).unwrap(),
            of: of.to_owned(),
        }
    }

    /// Calls a service, and again until it is there.
    fn call<Q, R>(&mut self, name: &str, kind: &str, request: &Q) -> R
    where
        Q: Message + Clone + 'static,
        R: Message + 'static,
    {
        let answer = self.call_until(name, kind, request, &mut || false);
        answer.unwrap_or_else(|| panic!("{name} of {} has not answered", self.of))
    }

    /// Calls a service, and again until it answers or `is_over`.
    fn call_until<Q, R>(
        &mut self,
        name: &str,
        kind: &str,
        request: &Q,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Option<R>
    where
        Q: Message + Clone + 'static,
        R: Message + 'static,
    {
        let qos = QosProfile::publisher_default();
        let client = self.node.create_client::<Q, R>(
            ServiceMapping::Enhanced,
            &Name::new(&self.of, name).unwrap(),
            &ServiceTypeName::new("rcl_interfaces", kind),
            qos.clone(),
            qos,
        );
        let client = client.unwrap();
        let until = Instant::now() + PATIENCE;
        // Answers to others' requests come here too.
        let mut sent = Vec::new();
        while Instant::now() < until && !is_over() {
            sent.push(client.send_request(request.clone()).unwrap());
            for _ in 0..50 {
                while let Ok(Some((id, response))) = client.receive_response() {
                    if sent.contains(&id) {
                        return Some(response);
                    }
                }
                std::thread::sleep(Duration::from_millis(10));
            }
        }
        None
    }

    fn list(&mut self) -> Vec<String> {
        let request = ListParametersRequest {
            prefixes: Vec::new(),
            depth: 0,
        };
        let listed: ListParametersResponse =
            self.call("list_parameters", "ListParameters", &request);
        listed.result.names
    }

    fn get(&mut self, wanted: &[&str]) -> Vec<ParameterValue> {
        let request = GetParametersRequest {
            names: names(wanted),
        };
        let got: GetParametersResponse = self.call("get_parameters", "GetParameters", &request);
        got.values.into_iter().map(ParameterValue::from).collect()
    }

    fn types(&mut self, wanted: &[&str]) -> Vec<u8> {
        let request = GetParameterTypesRequest {
            names: names(wanted),
        };
        let got: GetParameterTypesResponse =
            self.call("get_parameter_types", "GetParameterTypes", &request);
        got.values
    }

    fn describe(&mut self, wanted: &[&str]) -> Vec<raw::ParameterDescriptor> {
        let request = DescribeParametersRequest {
            names: names(wanted),
        };
        let got: DescribeParametersResponse =
            self.call("describe_parameters", "DescribeParameters", &request);
        got.values
    }

    /// Sets parameters one by one; the reasons why they are refused, empty where they are not.
    fn set(&mut self, values: &[(&str, ParameterValue)]) -> Vec<String> {
        let got: SetParametersResponse =
            self.call("set_parameters", "SetParameters", &request(values));
        got.results.into_iter().map(reason).collect()
    }

    fn set_atomically(&mut self, values: &[(&str, ParameterValue)]) -> String {
        let got: SetParametersAtomicallyResponse = self.call(
            "set_parameters_atomically",
            "SetParametersAtomically",
            &request(values),
        );
        reason(got.result)
    }
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn request(values: &[(&str, ParameterValue)]) -> SetParametersRequest {
    let parameter = |(name, value): &(&str, ParameterValue)| raw::Parameter {
        name: (*name).to_owned(),
        value: value.clone().into(),
    };
    SetParametersRequest {
        parameter: values.iter().map(parameter).collect(),
    }
}

fn reason(result: raw::SetParametersResult) -> String {
    assert_eq!(result.successful, result.reason.is_empty(), "{result:?}");
    result.reason
}

fn text(text: &str) -> ParameterValue {
    ParameterValue::String(text.to_owned())
}

#[test]
fn parameters_are_described_and_checked() {
    let domain = 67;
    let arguments = [
        "encode",
        "--frame-id",
        "left",
        "--ros-args",
        "-p",
        "window_us:=8000",
    ];
    let _encode = Program::eecvs_ros(domain, &arguments);
    let mut client = Client::new(domain, "/event_camera/encode");

    let listed = client.list();
    for name in [
        "window_us",
        "frame_id",
        "keep_order",
        "idle_s",
        "use_sim_time",
        "reliable",
    ] {
        assert!(listed.contains(&name.to_owned()), "{name}: {listed:?}");
    }
    assert!(!listed.iter().any(|name| name == "help"), "{listed:?}");
    let all = [
        "window_us",
        "frame_id",
        "keep_order",
        "idle_s",
        "use_sim_time",
        "m",
    ];
    let values = client.get(&all);
    let want = [
        ParameterValue::Integer(8000),
        text("left"),
        ParameterValue::Boolean(false),
        ParameterValue::NotSet,
        ParameterValue::Boolean(false),
        ParameterValue::Integer(16),
    ];
    assert_eq!(values, want);
    assert_eq!(client.types(&all), [2, 4, 1, 0, 1, 2]);
    // As of rclcpp, an undeclared name leaves the whole answer empty.
    assert!(client.get(&["window_us", "other"]).is_empty());
    assert!(client.types(&["window_us", "other"]).is_empty());
    assert!(client.describe(&["window_us", "other"]).is_empty());

    // A reply of several fragments.
    let names: Vec<&str> = listed.iter().map(String::as_str).collect();
    let described = client.describe(&names);
    assert!(described.iter().map(|each| &each.name).eq(&listed));
    let described = client.describe(&["window_us", "max_error", "coder", "connect", "idle_s"]);
    let kinds: Vec<u8> = described.iter().map(|each| each.r#type).collect();
    assert_eq!(kinds, [2, 3, 4, 9, 2]);
    let window = &described[0];
    assert_eq!(window.name, "window_us");
    assert!(
        window
            .description
            .contains("Window duration in microseconds")
    );
    assert!(window.read_only && !window.dynamic_typing);
    assert!(
        window
            .additional_constraints
            .contains("when the node starts")
    );
    let range = &window.integer_range[0];
    assert_eq!((range.from_value, range.to_value), (1, u32::MAX.into()));
    assert!(window.floating_point_range.is_empty());
    assert!(
        described[2]
            .additional_constraints
            .contains("plain, fast, quick, dense")
    );

    let refused = client.set(&[
        ("window_us", text("8000")),
        ("window_us", ParameterValue::Integer(5000)),
        ("other", ParameterValue::Integer(1)),
        ("use_sim_time", ParameterValue::Boolean(true)),
        ("use_sim_time", text("true")),
        ("use_sim_time", ParameterValue::Boolean(false)),
        ("use_sim_time", ParameterValue::NotSet),
    ]);
    let want = [
        "'window_us' cannot be set because it is read-only: it takes effect when the node starts",
        "'window_us' cannot be set because it is read-only",
        "'other' cannot be set because it was not declared",
        "use_sim_time: true is not supported: messages are stamped by the computer's clock",
        "{use_sim_time} is of type {bool}, setting it to {string} is not allowed",
        "",
        "cannot undeclare",
    ];
    assert_eq!(refused.len(), want.len());
    for (refused, want) in refused.iter().zip(want) {
        assert!(refused.contains(want), "{refused} is not {want}");
        assert_eq!(refused.is_empty(), want.is_empty(), "{refused}");
    }
    let refused = client.set_atomically(&[
        ("use_sim_time", ParameterValue::Boolean(false)),
        ("window_us", ParameterValue::Integer(5000)),
    ]);
    assert!(refused.contains("read-only"), "{refused}");
    assert_eq!(client.get(&["window_us"]), [ParameterValue::Integer(8000)]);
}

/// Pictures change while they are published, and the change is announced.
#[test]
fn what_is_set_takes_effect() {
    let domain = 68;
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let images = node.subscription("/event_camera/image", Image::TYPE, QOS);
    let mut images = images.unwrap();
    let decode = Program::eecvs_ros(domain, &["decode", "--ros-args", "-p", "image:=rgb8"]);
    let encode = Program::eecvs_ros(domain, &["encode", "--window-us", "20000"]);
    let arguments = "emulate --width 120 --height 90 --wait-s 20 --repeat --rate 0.5x";
    let arguments: Vec<&str> = arguments.split(' ').collect();
    let emulate = Program::eecvs_ros(domain, &arguments);
    let mut client = Client::new(domain, "/event_camera/decode");
    let topic = client.node.create_topic(
        &Name::new("/", "parameter_events").unwrap(),
        MessageTypeName::new("rcl_interfaces", "ParameterEvent"),
        &QosProfile::publisher_default(),
    );
    let changes = client.node.create_subscription::<raw::ParameterEvent>(
        &topic.unwrap(),
        Some(QosProfile::publisher_default()),
    );
    let changes = changes.unwrap();
    let mut until = |encoding: &str| {
        let until = Instant::now() + PATIENCE;
        loop {
            let cdr = images.take(PATIENCE).unwrap().expect("a picture");
            let image: Image = from_cdr(&cdr).unwrap();
            if image.encoding == encoding {
                return image;
            }
            assert!(Instant::now() < until, "{}", image.encoding);
        }
    };
    until("rgb8");
    assert_eq!(client.set(&[("image", text("mono8"))]), [""]);
    let image = until("mono8");
    assert_eq!((image.step, image.data.len()), (120, 120 * 90));
    assert_eq!(client.get(&["image"]), [text("mono8")]);
    let change = {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Ok(Some((change, _))) = changes.take()
                && change.node == "/event_camera/decode"
            {
                break change;
            }
            assert!(Instant::now() < until, "no change is announced");
            std::thread::sleep(Duration::from_millis(10));
        }
    };
    assert_eq!(change.changed_parameters[0].name, "image");
    assert_eq!(change.changed_parameters[0].value.string_value, "mono8");

    let refused = client.set(&[
        ("image", text("gif")),
        ("image", ParameterValue::Integer(8)),
        ("image_hz", ParameterValue::Integer(5)),
        ("image_hz", ParameterValue::Double(0.0)),
        ("image_hz", ParameterValue::Double(2.0)),
    ]);
    let want = [
        "possible values: mono8, rgb8",
        "{image} is of type {string}, setting it to {integer}",
        "{image_hz} is of type {double}, setting it to {integer}",
        "0 is not in 0.001..=1000",
        "",
    ];
    assert_eq!(refused.len(), want.len());
    for (refused, want) in refused.iter().zip(want) {
        assert!(refused.contains(want), "{refused} is not {want}");
        assert_eq!(refused.is_empty(), want.is_empty(), "{refused}");
    }
    let described = &client.describe(&["image_hz"])[0];
    let range = &described.floating_point_range[0];
    assert!((range.from_value - 0.001).abs() < 1e-9 && range.to_value == 1000.0);
    assert!(!described.read_only);
    // All or none.
    let both = [
        ("image", text("rgb8")),
        ("image_hz", ParameterValue::Double(-1.0)),
    ];
    assert!(client.set_atomically(&both).contains("-1 is not in"));
    assert_eq!(client.get(&["image"]), [text("mono8")]);
    let both = [
        ("image", text("rgb8")),
        ("image_hz", ParameterValue::Double(30.0)),
    ];
    assert_eq!(client.set_atomically(&both), "");
    until("rgb8");
    drop((emulate, encode, decode));
}

/// A scene that would take minutes ends at once.
#[test]
fn the_rate_of_a_scene_can_be_set() {
    let domain = 69;
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let events = node.subscription("/event_camera/events", EventPacket::TYPE, QOS);
    let mut events = events.unwrap();
    let slow = "emulate --width 120 --height 90 --duration-us 300000 --wait-s 20 --rate 0.0005x";
    let slow: Vec<&str> = slow.split(' ').collect();
    let mut emulate = Program::eecvs_ros(domain, &slow);
    assert!(events.take(PATIENCE).unwrap().is_some());
    let mut client = Client::new(domain, "/event_camera/emulate");
    let refused = client.set(&[
        ("rate", text("quick")),
        ("rate", ParameterValue::Integer(5)),
    ]);
    assert!(refused[0].contains("--rate"), "{refused:?}");
    assert!(
        refused[1].contains("{rate} is of type {string}"),
        "{refused:?}"
    );
    // The node ends at once: its answer may come before the client is known to it.
    let set: Option<SetParametersResponse> = client.call_until(
        "set_parameters",
        "SetParameters",
        &request(&[("rate", text("max"))]),
        &mut || emulate.has_ended(),
    );
    let reasons = set.into_iter().flat_map(|set| set.results).map(reason);
    assert!(reasons.into_iter().all(|reason| reason.is_empty()));
    let (_, said) = emulate.finish(PATIENCE);
    // As many as at its own speed.
    let whole = emulated(&Network::dds(domain), 300_000).finish(PATIENCE).1;
    let count = |said: &str| said.split(" events in ").next().map(str::to_owned);
    assert_eq!(count(&said), count(&whole));
}
