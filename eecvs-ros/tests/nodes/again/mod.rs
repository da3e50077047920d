//! Messages of any type that is sent here.

use eecvs_ros::message::{
    Density, DiagnosticArray, EventPacket, Frame, Image, Message, Type, Volume, from_cdr, to_cdr,
};

/// A message of a type, read and serialised again; `None` where it is none.
pub fn again(kind: Type, cdr: &[u8]) -> Option<Vec<u8>> {
    fn of<M: Message>(cdr: &[u8]) -> Option<Vec<u8>> {
        from_cdr::<M>(cdr).ok().map(|message| to_cdr(&message))
    }
    match kind.name {
        name if name == EventPacket::TYPE.name => of::<EventPacket>(cdr),
        name if name == Frame::TYPE.name => of::<Frame>(cdr),
        name if name == Density::TYPE.name => of::<Density>(cdr),
        name if name == Volume::TYPE.name => of::<Volume>(cdr),
        name if name == Image::TYPE.name => of::<Image>(cdr),
        name if name == DiagnosticArray::TYPE.name => of::<DiagnosticArray>(cdr),
        other => panic!("{other}"),
    }
}
