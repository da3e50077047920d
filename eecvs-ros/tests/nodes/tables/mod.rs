//! Tables in one form: what each row has, as texts, by the names of columns. CSV and MCAP are read by other crates.

mod parquet;

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

pub use parquet::parquet;

/// A row's values; those that are missing are not there.
pub type Row = BTreeMap<String, String>;

/// A float, so that others are other texts.
pub fn number(float: f64) -> String {
    format!("{float:?}")
}

/// A CSV file's rows.
pub fn csv(path: &Path) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let names = reader.headers().unwrap().clone();
    let cell = |text: &str| match text.parse::<f64>() {
        Ok(float) if text.contains(['.', 'e']) => number(float),
        _ => text.to_owned(),
    };
    reader
        .records()
        .map(|record| {
            let record = record.unwrap();
            let cells = names.iter().zip(&record);
            cells
                .filter(|(_, text)| !text.is_empty())
                .map(|(name, text)| (name.to_owned(), cell(text)))
                .collect()
        })
        .collect()
}

/// The rows of a topic's messages in an MCAP file; of arrays, each element's.
pub fn mcap(path: &Path, topic: &str) -> Vec<Row> {
    let bytes = std::fs::read(path).unwrap();
    let mut rows = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        if message.channel.topic != topic {
            continue;
        }
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(schema.encoding, "jsonschema");
        let schema: Value = serde_json::from_slice(&schema.data).unwrap();
        let values: BTreeMap<String, Value> = serde_json::from_slice(&message.data).unwrap();
        let arrays = values.values().filter_map(Value::as_array).map(Vec::len);
        let count = arrays.max().unwrap_or(1);
        for at in 0..count {
            let mut row = Row::new();
            for (name, value) in &values {
                let of = &schema["properties"][name];
                let (of, value) = match value {
                    Value::Array(all) => (&of["items"], &all[at]),
                    one => (of, one),
                };
                let (kind, text) = match value {
                    Value::Number(float) if float.is_f64() => {
                        ("number", number(float.as_f64().unwrap()))
                    }
                    Value::Number(whole) => ("integer", whole.to_string()),
                    Value::String(text) => ("string", text.clone()),
                    other => panic!("{name}: {other}"),
                };
                assert_eq!(of["type"], kind, "{name}");
                row.insert(name.clone(), text);
            }
            rows.push(row);
        }
    }
    rows
}
