//! What the images to flash hold: no floating point, no heap, no panic, and how much flash, RAM
//! and stack they can take at the most. Reads the ELF files; skips those that `firmware/build.sh` has
//! not made.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use object::{Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};

/// An image to flash, and its limits.
struct Build {
    /// What `firmware/build.sh` calls it.
    machine: &'static str,
    /// The link's interrupt.
    interrupt: &'static str,
    flash_bytes_max: u64,
    /// With the stack.
    ram_bytes_max: u64,
    /// Of the linker script.
    stack_bytes: u32,
}

// Of the 1 MiB of flash that an STM32F405 has, 240 KiB are the lines of the DTFT of 16 frequencies and 64
// KiB those of the DCT of 9 to 16 coefficients, which take less than half of the instructions that a
// smaller table's do.
const BUILDS: [Build; 3] = [
    Build {
        machine: "netduinoplus2",
        interrupt: "USART1",
        flash_bytes_max: 470 << 10,
        ram_bytes_max: 112 << 10,
        stack_bytes: 10 << 10,
    },
    // The USB stack takes about 27 KiB of flash, the queue to the host 4 KiB of RAM.
    Build {
        machine: "usb",
        interrupt: "OTG_FS",
        flash_bytes_max: 496 << 10,
        ram_bytes_max: 120 << 10,
        stack_bytes: 10 << 10,
    },
    Build {
        machine: "small",
        interrupt: "USART1",
        flash_bytes_max: 64 << 10,
        ram_bytes_max: 48 << 10,
        stack_bytes: 7 << 10,
    },
];
/// What the processor pushes when an exception comes: 8 words, and one to align; without floating
/// point there are no more.
const EXCEPTION_BYTES: u32 = 9 * 4;

/// A function of the image, decoded as far as the checks need it.
#[derive(Debug, Default)]
struct Function {
    name: String,
    /// Every byte that any of its instructions takes from the stack pointer.
    frame_bytes: u32,
    /// Addresses that it calls or jumps to outside of itself.
    calls: BTreeSet<u32>,
    /// Calls of addresses in registers.
    indirect: u32,
    /// Instructions of the floating-point unit.
    float: u32,
}

struct Image {
    functions: BTreeMap<u32, Function>,
    symbols: Vec<String>,
    flash_bytes: u64,
    ram_bytes: u64,
}

/// The encoder's images, with a note for each that is not there.
fn images() -> Vec<(&'static Build, Image)> {
    let images = BUILDS.iter().filter_map(|build| {
        let machine = build.machine;
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
            .join("../firmware/target")
            .join(machine)
            .join("thumbv7em-none-eabihf/release/encoder");
        let Ok(bytes) = std::fs::read(&path) else {
            eprintln!("skipped: no image; firmware/build.sh {machine} makes it");
            return None;
        };
        Some((build, read(&bytes)))
    });
    images.collect()
}

fn read(bytes: &[u8]) -> Image {
    let elf = object::File::parse(bytes).expect("an ELF file");
    let (mut flash_bytes, mut ram_bytes) = (0, 0);
    let mut code = Vec::new();
    for section in elf.sections() {
        // Everything else (debugging, logs' texts) stays on the host; flash begins above 0.
        let is_loaded = section.address() > 0;
        match section.kind() {
            SectionKind::Text if is_loaded => {
                let data = section.data().expect("the section's content");
                code.push((section.address() as u32, data));
                flash_bytes += section.size();
            }
            SectionKind::ReadOnlyData | SectionKind::ReadOnlyString if is_loaded => {
                flash_bytes += section.size();
            }
            SectionKind::Data if is_loaded => {
                flash_bytes += section.size();
                ram_bytes += section.size();
            }
            SectionKind::UninitializedData => ram_bytes += section.size(),
            _ => {}
        }
    }
    // Where instructions and where constants are.
    let mut spans = BTreeMap::new();
    let mut starts = BTreeMap::new();
    let mut symbols = Vec::new();
    for symbol in elf.symbols() {
        let name = symbol.name().unwrap_or_default();
        let address = symbol.address() as u32;
        match name {
            _ if name == "$t" || name.starts_with("$t.") => {
                spans.insert(address, true);
            }
            _ if name.starts_with('$') => {
                spans.insert(address, false);
            }
            _ if symbol.kind() == SymbolKind::Text => {
                let end = (symbol.size() > 0).then(|| (address & !1) + symbol.size() as u32);
                starts.insert(address & !1, (name.to_string(), end));
                symbols.push(name.to_string());
            }
            _ => symbols.push(name.to_string()),
        }
    }
    let mut functions = BTreeMap::new();
    let ends = starts.keys().skip(1).copied().chain([u32::MAX]);
    for ((start, (name, sized)), next) in starts.iter().zip(ends) {
        // What fills the gap to the next function are no instructions, though they look like some.
        let end = sized.map_or(next, |end| end.min(next));
        let mut function = Function {
            name: name.clone(),
            ..Function::default()
        };
        for (base, data) in &code {
            let from = start.max(base);
            let to = end.min(base + data.len() as u32);
            if *from < to {
                let data = &data[(from - base) as usize..(to - base) as usize];
                decode(*from, data, end, &spans, &mut function);
            }
        }
        functions.insert(*start, function);
    }
    Image {
        functions,
        symbols,
        flash_bytes,
        ram_bytes,
    }
}

/// Goes through the instructions of `data`, which stands at `start`.
fn decode(start: u32, data: &[u8], end: u32, spans: &BTreeMap<u32, bool>, function: &mut Function) {
    let half = |at: u32| {
        let at = (at - start) as usize;
        data.get(at..at + 2)
            .map(|bytes| u32::from(u16::from_le_bytes([bytes[0], bytes[1]])))
    };
    let mut at = start;
    while let Some(first) = half(at) {
        let is_code = spans.range(..=at).next_back().is_none_or(|(_, code)| *code);
        if !is_code {
            at += 2;
            continue;
        }
        if first < 0xE800 {
            narrow(at, first, start, end, function);
            at += 2;
        } else {
            let second = half(at + 2).unwrap_or(0);
            wide(at, first, second, start, end, function);
            at += 4;
        }
    }
}

/// A 16-bit instruction.
fn narrow(at: u32, code: u32, start: u32, end: u32, function: &mut Function) {
    if code & 0xFE00 == 0xB400 {
        // push {r0-r7, lr}
        function.frame_bytes += 4 * (code & 0x1FF).count_ones();
    } else if code & 0xFF80 == 0xB080 {
        // sub sp, #imm7 * 4
        function.frame_bytes += 4 * (code & 0x7F);
    } else if code & 0xFF87 == 0x4780 {
        // blx register
        function.indirect += 1;
    } else if code & 0xFF87 == 0x4700 && (code >> 3) & 15 != 14 {
        // bx register, but for the link register
        function.indirect += 1;
    } else if code & 0xF800 == 0xE000 {
        // b
        let offset = ((code & 0x7FF) << 21) as i32 >> 20;
        jump(at, offset, start, end, function);
    } else if code & 0xF000 == 0xD000 && (code >> 8) & 15 < 14 {
        // b, conditional
        let offset = ((code & 0xFF) << 24) as i32 >> 23;
        jump(at, offset, start, end, function);
    }
}

/// A 32-bit instruction.
fn wide(at: u32, first: u32, second: u32, start: u32, end: u32, function: &mut Function) {
    if first == 0xE92D {
        // push.w
        function.frame_bytes += 4 * second.count_ones();
    } else if first == 0xF84D && second & 0xFFF == 0xD04 {
        // str register, [sp, #-4]!
        function.frame_bytes += 4;
    } else if first & 0xFBFF == 0xF1AD && second & 0x8F00 == 0x0D00 {
        // sub.w sp, sp, #modified constant
        function.frame_bytes +=
            modified_constant((first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF);
    } else if first & 0xFBFF == 0xF2AD && second & 0x8F00 == 0x0D00 {
        // subw sp, sp, #imm12
        function.frame_bytes += (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
    } else if first & 0xFFE0 == 0xE960 && first & 15 == 13 {
        // strd, [sp, #-imm8 * 4]!
        function.frame_bytes += 4 * (second & 0xFF);
    } else if first & 0xEC00 == 0xEC00 && second & 0x0E00 == 0x0A00 {
        // Coprocessors 10 and 11.
        function.float += 1;
    } else if first & 0xF800 == 0xF000 && second & 0x8000 != 0 {
        // bl, b.w
        let sign = first >> 10 & 1;
        if second & 0x1000 != 0 || second & 0x4000 != 0 {
            let bit = |j: u32| !(second >> j ^ sign) & 1;
            let raw = sign << 24
                | bit(13) << 23
                | bit(11) << 22
                | (first & 0x3FF) << 12
                | (second & 0x7FF) << 1;
            jump(at, (raw << 7) as i32 >> 7, start, end, function);
        } else if (first >> 6 & 15) < 14 {
            let raw = sign << 20
                | (second >> 11 & 1) << 19
                | (second >> 13 & 1) << 18
                | (first & 0x3F) << 12
                | (second & 0x7FF) << 1;
            jump(at, (raw << 11) as i32 >> 11, start, end, function);
        }
    } else if (first & 0xFFF0 == 0xF8D0 || first == 0xF85F) && second >> 12 == 15 {
        // ldr pc
        function.indirect += 1;
    }
}

/// `ThumbExpandImm`.
fn modified_constant(imm12: u32) -> u32 {
    let byte = imm12 & 0xFF;
    match imm12 >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte << 24 | byte << 16 | byte << 8 | byte,
        _ => (0x80 | imm12 & 0x7F).rotate_right(imm12 >> 7),
    }
}

fn jump(at: u32, offset: i32, start: u32, end: u32, function: &mut Function) {
    let target = at.wrapping_add(4).wrapping_add_signed(offset);
    if target < start || target >= end {
        function.calls.insert(target);
    }
}

impl Image {
    fn named(&self, name: &str) -> u32 {
        self.functions
            .iter()
            .find(|(_, function)| function.name == name)
            .map(|(address, _)| *address)
            .unwrap_or_else(|| panic!("the image has {name}"))
    }

    /// Most stack that a call of the function at `address` takes, itself included, and the frames
    /// it is made of, innermost first.
    fn depth(&self, address: u32, path: &mut Vec<u32>) -> (u32, Vec<String>) {
        // A jump may lead into the middle of a function.
        let Some((start, function)) = self.functions.range(..=address).next_back() else {
            panic!("no function at {address:#x}");
        };
        if path.contains(start) {
            panic!("{} calls itself: no bound", function.name);
        }
        if is_panic(&function.name) {
            // Ends in `fault.rs`, whose stack is a new one.
            return (function.frame_bytes, Vec::new());
        }
        path.push(*start);
        let mut calls = function.calls.clone();
        if function.indirect > 0 {
            // The USB stack calls its classes, any of theirs here; nothing else calls what it does not name.
            let name = &function.name;
            assert!(
                is_usb_stack(name),
                "{name} calls through a register: no bound"
            );
            let classes = self.functions.iter();
            let classes = classes.filter(|(_, function)| function.name.contains("UsbClass"));
            calls.extend(classes.map(|(address, _)| *address));
        }
        let below = calls.iter().map(|call| self.depth(*call, path));
        let deepest = below.max_by_key(|(bytes, _)| *bytes);
        path.pop();
        let (bytes, mut names) = deepest.unwrap_or_default();
        names.push(format!("{} {}", function.frame_bytes, function.name));
        (function.frame_bytes + bytes, names)
    }

    /// `main`, with the interrupts one over the other by priority: PendSV, then the link or the timer.
    fn stack_bound(&self, interrupt: &str) -> u32 {
        let depth = |name: &str| {
            let (bytes, path) = self.depth(self.named(name), &mut Vec::new());
            println!("{bytes} bytes, innermost first: {path:#?}");
            bytes
        };
        let interrupts = depth(interrupt).max(depth("SysTick")) + depth("PendSV");
        depth("Reset") + interrupts + 2 * EXCEPTION_BYTES
    }
}

/// Whether the name is of what a panic runs through.
fn is_panic(name: &str) -> bool {
    [
        "panic",
        "slice_index_fail",
        "expect_failed",
        "unwrap_failed",
    ]
    .iter()
    .any(|part| name.contains(part))
}

/// Whether the name is of the USB stack's own code: the stack, the driver of its controller, the serial
/// port's class, and the few functions that call them and so have parts of them within. Their checks, of
/// the controller's registers and of what their callers ask for, stay in the image; `usb_class.rs` of
/// usb-bridge has found no host that reaches one.
fn is_usb_stack(name: &str) -> bool {
    const CRATES: [&str; 3] = ["usb_device", "synopsys_usb_otg", "usbd_serial"];
    const CALLERS: [(&str, &str); 5] = [
        ("eecvs_usb_class", "poll_stack"),
        ("eecvs_usb_class", "refuse_excess"),
        ("eecvs_usb_class", "4read"),
        ("eecvs_usb_class", "5write"),
        ("eecvs_firmware", "otg7connect"),
    ];
    let is_caller =
        |(part, function): &(&str, &str)| name.contains(part) && name.contains(function);
    CRATES.iter().any(|part| name.contains(part)) || CALLERS.iter().any(is_caller)
}

/// The one panic that stays: a log that is started twice, which no byte of the link can do.
const STARTS_LOG: [&str; 1] = ["_defmt_acquire"];

#[test]
fn there_is_no_floating_point() {
    const SOFT: [&str; 8] = [
        "__aeabi_d",
        "__aeabi_f",
        "__aeabi_ui2f",
        "__aeabi_ui2d",
        "__aeabi_i2f",
        "__aeabi_i2d",
        "__aeabi_l2",
        "__aeabi_ul2",
    ];
    for (_, image) in images() {
        for function in image.functions.values() {
            assert_eq!(function.float, 0, "{}", function.name);
        }
        for symbol in &image.symbols {
            let is_soft = SOFT.iter().any(|name| symbol.starts_with(name));
            assert!(!is_soft, "{symbol}");
        }
    }
}

#[test]
fn there_is_no_heap() {
    for (_, image) in images() {
        for symbol in &image.symbols {
            assert!(
                !symbol.contains("rust_alloc") && symbol != "malloc",
                "{symbol}"
            );
        }
    }
}

#[test]
fn there_is_no_panic() {
    for (build, image) in images() {
        let panics: Vec<_> = image
            .functions
            .values()
            .filter(|function| {
                let name = function.name.as_str();
                !is_panic(name) && !STARTS_LOG.contains(&name) && !is_usb_stack(name)
            })
            .filter(|function| {
                let mut calls = function.calls.iter();
                calls.any(|call| image.named_at(*call).is_some_and(is_panic))
            })
            .map(|function| function.name.as_str())
            .collect();
        assert!(panics.is_empty(), "{}: {panics:#?}", build.machine);
    }
}

impl Image {
    fn named_at(&self, address: u32) -> Option<&str> {
        self.functions
            .get(&address)
            .map(|function| function.name.as_str())
    }
}

#[test]
fn flash_ram_and_stack_are_within_bounds() {
    for (build, image) in images() {
        let stack = image.stack_bound(build.interrupt);
        println!(
            "{}: flash {} bytes, RAM {} bytes, stack at most {stack} bytes",
            build.machine, image.flash_bytes, image.ram_bytes
        );
        assert!(stack <= build.stack_bytes, "{stack}");
        assert!(
            image.flash_bytes <= build.flash_bytes_max,
            "{}",
            image.flash_bytes
        );
        assert!(
            image.ram_bytes + u64::from(stack) <= build.ram_bytes_max,
            "{} + {stack}",
            image.ram_bytes
        );
    }
}
