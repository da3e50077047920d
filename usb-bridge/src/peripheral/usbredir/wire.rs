//! Constants of the usbredir protocol, version 0.7.

/// Packet types.
pub(super) mod packet {
    pub const HELLO: u32 = 0;
    pub const DEVICE_CONNECT: u32 = 1;
    pub const DEVICE_DISCONNECT: u32 = 2;
    pub const RESET: u32 = 3;
    pub const INTERFACE_INFO: u32 = 4;
    pub const ENDPOINT_INFO: u32 = 5;
    pub const SET_CONFIGURATION: u32 = 6;
    pub const GET_CONFIGURATION: u32 = 7;
    pub const CONFIGURATION_STATUS: u32 = 8;
    pub const SET_SETTING: u32 = 9;
    pub const GET_SETTING: u32 = 10;
    pub const SETTING_STATUS: u32 = 11;
    pub const START_ISOCHRONOUS: u32 = 12;
    pub const STOP_ISOCHRONOUS: u32 = 13;
    pub const ISOCHRONOUS_STATUS: u32 = 14;
    pub const START_INTERRUPT: u32 = 15;
    pub const STOP_INTERRUPT: u32 = 16;
    pub const INTERRUPT_STATUS: u32 = 17;
    pub const ALLOCATE_STREAMS: u32 = 18;
    pub const FREE_STREAMS: u32 = 19;
    pub const STREAMS_STATUS: u32 = 20;
    pub const CANCEL: u32 = 21;
    pub const FILTER_REJECT: u32 = 22;
    pub const FILTER: u32 = 23;
    pub const DISCONNECT_ACK: u32 = 24;
    pub const CONTROL: u32 = 100;
    pub const BULK: u32 = 101;
    pub const INTERRUPT: u32 = 103;
}

/// Capabilities, as bits of the first word in the hello.
pub(super) mod capability {
    pub const DEVICE_VERSION: u32 = 1 << 1;
    pub const DISCONNECT_ACK: u32 = 1 << 3;
    pub const ENDPOINT_PACKETS: u32 = 1 << 4;
    pub const LONG_IDS: u32 = 1 << 5;
    pub const LONG_BULK: u32 = 1 << 6;
    pub const OURS: u32 = DEVICE_VERSION | DISCONNECT_ACK | ENDPOINT_PACKETS | LONG_IDS | LONG_BULK;
}

/// Status codes of an answer.
pub(super) mod status {
    pub const SUCCESS: u8 = 0;
    pub const CANCELLED: u8 = 1;
    pub const INVALID: u8 = 2;
    pub const STALL: u8 = 4;
    pub const BABBLE: u8 = 6;
}
