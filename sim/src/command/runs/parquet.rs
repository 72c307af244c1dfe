//! A table as a Parquet file.

use super::export::Column;
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;
use std::sync::Arc;

/// The bytes of a file with one row group, without compression; every column is optional.
pub(super) fn file(columns: &[(String, Column)]) -> Result<Vec<u8>> {
    let field = |(name, column): &(String, Column)| {
        let (physical, logical) = match column {
            Column::Text(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
            Column::Integer(_) => (Physical::INT64, None),
            Column::Real(_) => (Physical::DOUBLE, None),
        };
        let field = Type::primitive_type_builder(name, physical).with_repetition(Repetition::OPTIONAL);
        field.with_logical_type(logical).build().map(Arc::new)
    };
    let fields = columns.iter().map(field).collect::<Result<Vec<_>>>()?;
    let schema = Type::group_type_builder("runs").with_fields(fields).build()?;
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(WriterProperties::default()))?;
    let mut group = writer.next_row_group()?;
    for (name, column) in columns {
        let missing = || ParquetError::General(format!("the schema lacks the column {name}"));
        let mut out = group.next_column()?.ok_or_else(missing)?;
        match column {
            Column::Text(values) => write::<ByteArrayType, _>(&mut out, values, |text| ByteArray::from(text.as_str())),
            Column::Integer(values) => write::<Int64Type, _>(&mut out, values, |value| *value),
            Column::Real(values) => write::<DoubleType, _>(&mut out, values, |value| *value),
        }?;
        out.close()?;
    }
    group.close()?;
    writer.into_inner()
}

/// The values that are there, and for each row whether there is one (definition level 1 or 0).
fn write<T: DataType, V>(
    out: &mut SerializedColumnWriter<'_>,
    values: &[Option<V>],
    stored: impl Fn(&V) -> T::T,
) -> Result<()> {
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let present: Vec<T::T> = values.iter().flatten().map(stored).collect();
    out.typed::<T>().write_batch(&present, Some(&levels), None).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use std::io::Write;

    #[test]
    fn what_is_written_is_read_back() {
        let columns = vec![
            ("name".to_owned(), Column::Text(vec![Some("Zürich 🚁".to_owned()), None, Some(String::new())])),
            ("count".to_owned(), Column::Integer(vec![None, Some(i64::MIN), Some(7)])),
            ("share".to_owned(), Column::Real(vec![Some(0.1), Some(f64::MIN_POSITIVE), None])),
        ];
        let mut written = tempfile::tempfile().unwrap();
        written.write_all(&file(&columns).unwrap()).unwrap();
        let reader = SerializedFileReader::new(written).unwrap();
        let rows: Vec<String> = reader.get_row_iter(None).unwrap().map(|row| row.unwrap().to_string()).collect();
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[0], r#"{name: "Zürich 🚁", count: null, share: 0.1}"#);
        assert!(rows[1].contains(&i64::MIN.to_string()), "{}", rows[1]);
        assert_eq!(rows[2], r#"{name: "", count: 7, share: null}"#);
    }
}
