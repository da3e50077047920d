"""A trace of a USB link by python-pcapng and by scapy, which know the file, but not what usbmon says in a packet.

    python tests/peers/trace.py FILE.pcapng

Prints a line for each packet as Wireshark's fields in usb-bridge's tests: the event, the kind of transfer, endpoint,
bus, device, number of bytes and status. Exits with 1 where the two libraries differ, and with 77 without either.
"""

import struct
import sys


def by_pcapng(path):
    from pcapng import FileScanner
    from pcapng.blocks import EnhancedPacket

    with open(path, "rb") as file:
        for block in FileScanner(file):
            if isinstance(block, EnhancedPacket):
                if len(block.packet_data) != block.packet_len:
                    sys.exit("a packet was cut")
                yield block.interface.link_type, block.packet_data, block.timestamp


def by_scapy(path):
    from scapy.utils import RawPcapNgReader

    with RawPcapNgReader(str(path)) as reader:
        for data, metadata in reader:
            ticks = metadata.tshigh << 32 | metadata.tslow
            yield metadata.linktype, data, ticks / metadata.tsresol


def packets_of(path):
    read = []
    for name, reader in [("python-pcapng", by_pcapng), ("scapy", by_scapy)]:
        try:
            read.append(list(reader(path)))
        except ImportError:
            print(f"absent: {name}", file=sys.stderr)
    if not read:
        sys.exit(77)
    for other in read[1:]:
        alike = len(other) == len(read[0]) and all(
            a[:2] == b[:2] and abs(a[2] - b[2]) < 1e-5 for a, b in zip(read[0], other)
        )
        if not alike:
            sys.exit("python-pcapng and scapy differ")
    return read[0]


def main():
    for link_type, data, at in packets_of(sys.argv[1]):
        # `USB_LINUX_MMAPPED`, in the order of this machine's bytes.
        if link_type != 220:
            sys.exit(f"link type {link_type}")
        _, event, kind, endpoint, device, bus = struct.unpack_from("=QBBBBH", data)
        seconds, micros, status, _, length = struct.unpack_from("=qiiII", data, 16)
        if abs(seconds + micros / 1e6 - at) > 1e-5:
            sys.exit(f"times {seconds}.{micros:06} and {at}")
        if len(data) != 64 + length:
            sys.exit(f"{len(data)} bytes of a packet with {length}")
        print(f"{chr(event)!r},0x{kind:02x},0x{endpoint:02x},{bus},{device},{length},{status}")


if __name__ == "__main__":
    main()
