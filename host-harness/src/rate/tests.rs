//! Rows of a small scene.

use eecvs_bench::source;
use event_types::test_events::{SENSOR, event};

use super::*;

const EFFORT: Effort = Effort {
    scene_us: 40_000,
    tolerances_us: &[50],
    bins: &[8],
    m: &[4],
    voxel_bins: &[5, 8],
};

fn rows() -> Vec<Row> {
    let source = source::scenes(EFFORT.scene_us).unwrap().remove(0);
    let mut steps = 0;
    let rows = measure(&source, EFFORT, &mut || steps += 1).unwrap();
    assert_eq!(steps, EFFORT.rows());
    rows
}

#[test]
fn every_row_is_there_once_and_its_metrics_are_what_applies() {
    let rows = rows();
    assert_eq!(rows.len(), EFFORT.rows());
    for row in &rows {
        let again = rows
            .iter()
            .filter(|other| (other.codec, &other.setting) == (row.codec, &row.setting));
        assert_eq!(again.count(), 1, "{row:?}");
        assert!(row.bits_per_event > 0.0 && row.seconds >= 0.0, "{row:?}");
        let is_transform = row.codec.starts_with("transform");
        assert_eq!(row.coefficients_nmse.is_some(), is_transform, "{row:?}");
        let is_voxel = row.codec == "voxel";
        assert_eq!(row.emd_pixel_us.is_none(), is_voxel, "{row:?}");
        let has_volume = !is_voxel || row.setting.starts_with("8 bins");
        assert_eq!(row.volume_nmse.is_some(), has_volume, "{row:?}");
        assert!(row.mse.is_some() && row.ssim.is_some());
        // All but TORE volumes keep the counts, and thus the frames, exactly.
        if row.codec != "tore" {
            assert_eq!((row.mse, row.ssim), (Some(0.0), Some(1.0)), "{row:?}");
        }
        if row.setting == "lossless" {
            assert_eq!(row.emd_pixel_us, Some(0.0));
            assert_eq!(row.volume_nmse, Some(0.0));
        }
    }
    let of = |codec: &str, setting: &str| {
        let mut rows = rows.iter();
        rows.find(|row| (row.codec, row.setting.as_str()) == (codec, setting))
            .unwrap()
    };
    assert!(of("hybrid-dense", "50 us").emd_pixel_us.unwrap() <= 50.0);
    assert_eq!(of("hybrid-dense", "8 bins").volume_nmse, Some(0.0));
    assert!(of("tore", "u8").bits_per_event < of("tore", "f32").bits_per_event);
}

#[test]
fn a_grid_of_eight_bins_is_held_against_the_box_volume() {
    let volume_nmse = |events: &[Event], stored| {
        let source = Source {
            name: "test".to_owned(),
            sensor: SENSOR,
            events: Arc::from(events),
        };
        let mut subject = Subject {
            source: &source,
            volume: ours::grid(&source).volume(events),
            rows: Vec::new(),
            progress: &mut || (),
        };
        subject.voxel(8, stored).unwrap();
        subject.rows.remove(0).volume_nmse.unwrap()
    };
    // At the ends of the window, nearly all weight is in the first or the last bin.
    let ends = [event(0, 4, 3, true), event(32_767, 4, 3, false)];
    assert!(volume_nmse(&ends, Stored::F32) < 1e-6);
    let many: Vec<Event> = (0..40)
        .map(|i| event(701 * i, (i % 3) as u16, 0, i % 5 > 0))
        .collect();
    let exact = volume_nmse(&many, Stored::F32);
    for (stored, most) in [(Stored::Bits16, 1e-4), (Stored::Bits8, 1e-2)] {
        let off = (volume_nmse(&many, stored) - exact).abs();
        assert!(off > 0.0 && off < most, "{off}");
    }
}
