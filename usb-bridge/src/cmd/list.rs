//! `eecvs-usb list`: lists the known devices that are attached.

use anyhow::Result;
use eecvs_cli::output::{print, print_json};
use serde::Serialize;

use crate::link::LinkError;
use crate::link::usb::{Attached, Bus, Use, speed_name};

/// List the known cameras and MCUs that are attached
///
/// If there are none, prints one line that says so and exits with status 0. A device that another program uses is
/// not disturbed: its firmware is not queried.
#[derive(Debug, clap::Args)]
pub struct List {
    /// Print an array of JSON objects with the keys id, model, name, vendor, product, release, serial,
    /// speed, use, firmware, sensor, problem
    #[arg(long)]
    json: bool,
}

/// One row of the list.
#[derive(Debug, PartialEq, Eq, Serialize)]
struct Row {
    id: String,
    model: &'static str,
    name: Option<String>,
    vendor: String,
    product: String,
    release: String,
    serial: Option<String>,
    speed: &'static str,
    r#use: &'static str,
    firmware: Option<String>,
    /// Width and height, in pixels.
    sensor: Option<[u16; 2]>,
    /// Why information is missing, or why the device will not work.
    problem: Option<String>,
}

impl List {
    /// Lists the devices on stdout.
    ///
    /// # Errors
    /// The system's USB cannot be used, or stdout cannot be written.
    pub fn run(self) -> Result<()> {
        let rows: Vec<_> = Bus::new()?.devices()?.iter().filter_map(row).collect();
        if self.json {
            print_json(&rows)
        } else if rows.is_empty() {
            print("No known camera or MCU is attached.\n")
        } else {
            print(&table(&rows))
        }
    }
}

fn row(attached: &Attached) -> Option<Row> {
    let model = attached.model?;
    let device = attached.try_open(model.transfers().interface);
    let mut row = Row {
        id: attached.id(),
        model: model.name(),
        name: attached.product_name.clone(),
        vendor: format!("{:04x}", attached.vendor),
        product: format!("{:04x}", attached.product),
        release: format!("{:04x}", attached.release),
        serial: attached.serial.clone(),
        speed: speed_name(attached.speed),
        r#use: Use::of(&device).name(),
        firmware: None,
        sensor: None,
        problem: None,
    };
    match device.map(|device| model.identify(&mut device.control())) {
        Ok(Ok(info)) => {
            row.name = Some(info.name);
            row.serial = info.serial.or(row.serial);
            row.firmware = Some(info.firmware);
            row.sensor = Some([info.sensor.width, info.sensor.height]);
        }
        Ok(Err(error)) => row.problem = Some(format!("{error:#}")),
        // The USE column shows this already.
        Err(LinkError::Busy { .. }) => {}
        Err(error) => row.problem = Some(error.to_string()),
    }
    if row.problem.is_none()
        && model.needs_super_speed()
        && let Err(error) = attached.require_super_speed()
    {
        row.problem = Some(error.to_string());
    }
    Some(row)
}

/// Formats the devices as an aligned table, with problems below it.
fn table(rows: &[Row]) -> String {
    let dash = |text: &Option<String>| text.clone().unwrap_or_else(|| "-".to_owned());
    let mut lines =
        vec![["ID", "MODEL", "NAME", "SERIAL", "SPEED", "USE", "FIRMWARE"].map(str::to_owned)];
    lines.extend(rows.iter().map(|row| {
        [
            row.id.clone(),
            row.model.to_owned(),
            dash(&row.name),
            dash(&row.serial),
            row.speed.to_owned(),
            row.r#use.to_owned(),
            dash(&row.firmware),
        ]
    }));
    let width = |column: usize| {
        let widths = lines.iter().map(|line| line[column].chars().count());
        widths.max().unwrap_or(0)
    };
    let widths: [usize; 7] = std::array::from_fn(width);
    let mut text = String::new();
    for line in &lines {
        let cells: Vec<_> = line
            .iter()
            .zip(widths)
            .map(|(cell, width)| format!("{cell:<width$}"))
            .collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
    }
    for row in rows {
        if let Some(problem) = &row.problem {
            text.push_str(problem);
            text.push('\n');
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_aligned_and_problems_come_below_it() {
        let row = Row {
            id: "usb:1-4".to_owned(),
            model: "evk4",
            name: None,
            vendor: "04b4".to_owned(),
            product: "00f5".to_owned(),
            release: "0000".to_owned(),
            serial: Some("00051234".to_owned()),
            speed: "480 Mbit/s",
            r#use: "free",
            firmware: Some("3.9".to_owned()),
            sensor: Some([1280, 720]),
            problem: Some("usb 1-4 evk4: needs USB 3".to_owned()),
        };
        assert_eq!(
            table(&[row]),
            "ID       MODEL  NAME  SERIAL    SPEED       USE   FIRMWARE\n\
             usb:1-4  evk4   -     00051234  480 Mbit/s  free  3.9\n\
             usb 1-4 evk4: needs USB 3\n"
        );
    }
}
