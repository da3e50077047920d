//! Messages as ROS 2 serialises them: `peers/cdr/*.json`, which `peers/cdr/write.sh` makes with rclpy.

use crate::again::again;
use eecvs_ros::message::{EventPacket, Malformed, Message, TYPES, TypeName, from_cdr};

#[test]
fn messages_have_the_bytes_of_ros() {
    for kind in TYPES {
        let name = TypeName::from(kind).parts().1;
        let path = format!("{}/peers/cdr/{name}.json", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(&path).unwrap();
        let golden: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(golden["type"], kind.name);
        assert_eq!(golden["hash"], kind.hash);
        let messages = golden["messages"].as_array().unwrap();
        assert!(messages.len() > 1);
        for message in messages {
            let digits = message["cdr"].as_str().unwrap().as_bytes();
            let cdr: Vec<u8> = digits
                .chunks(2)
                .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
                .collect();
            assert_eq!(again(kind, &cdr).as_ref(), Some(&cdr), "{name}");
            // Cut off anywhere, it is no message.
            for end in 0..cdr.len() {
                let cut = again(kind, &cdr[..end]);
                assert_eq!(cut, None, "{name} of {end} bytes of {}", cdr.len());
            }
        }
    }
}

#[test]
fn other_representations_are_refused() {
    for start in [[0, 0, 0, 0], [0, 2, 0, 0], [0, 7, 0, 0], [1, 1, 0, 0]] {
        let refused = from_cdr::<EventPacket>(&[start, [0; 4]].concat());
        assert_eq!(refused, Err(Malformed::Representation));
    }
    assert_eq!(from_cdr::<EventPacket>(&[]), Err(Malformed::Representation));
    assert_eq!(
        TypeName::from(EventPacket::TYPE).dds(),
        "event_camera_msgs::msg::dds_::EventPacket_"
    );
}
