//! Tables of LeRobot as Parquet files, uncompressed.

use std::io;
use std::path::Path;
use std::sync::Arc;

use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;

use crate::image::WholeFile;

/// Values of a column.
#[derive(Clone, Debug)]
pub(super) enum Column {
    Int(Vec<i64>),
    Float(Vec<f32>),
    Double(Vec<f64>),
    /// One text.
    Text(&'static str),
    /// One list of one text.
    TextList(&'static str),
    /// Files of images, as Hugging Face's `Image` has them: `bytes`, and a `path` that is
    /// not there.
    Image(Vec<Vec<u8>>),
}

type Rows<'a> = SerializedRowGroupWriter<'a, WholeFile>;

impl Column {
    /// What the schema says of it.
    fn field(&self, name: &str) -> String {
        match self {
            Self::Int(_) => format!("optional int64 {name};\n"),
            Self::Float(_) => format!("optional float {name};\n"),
            Self::Double(_) => format!("optional double {name};\n"),
            Self::Text(_) => format!("optional binary {name} (STRING);\n"),
            Self::TextList(_) => format!(
                "optional group {name} (LIST) {{ repeated group list {{ \
                 optional binary element (STRING); }} }}\n"
            ),
            Self::Image(_) => format!(
                "optional group {name} {{ optional binary bytes; \
                 optional binary path (STRING); }}\n"
            ),
        }
    }

    /// What numbers are called, and the numbers; nothing of others.
    pub(super) fn numbers(&self) -> Option<(&'static str, Vec<f64>)> {
        match self {
            Self::Int(values) => Some(("int64", values.iter().map(|&v| v as f64).collect())),
            Self::Float(values) => {
                Some(("float32", values.iter().copied().map(f64::from).collect()))
            }
            Self::Double(values) => Some(("float64", values.clone())),
            Self::Text(_) | Self::TextList(_) | Self::Image(_) => None,
        }
    }

    /// Writes it as the next one. How much of the nesting is there: all of it, but for the
    /// paths of images.
    fn write(self, rows: &mut Rows<'_>) -> Result<(), ParquetError> {
        match self {
            Self::Int(values) => leaf::<Int64Type>(rows, &values, &vec![1; values.len()]),
            Self::Float(values) => leaf::<FloatType>(rows, &values, &vec![1; values.len()]),
            Self::Double(values) => leaf::<DoubleType>(rows, &values, &vec![1; values.len()]),
            Self::Text(text) => leaf::<ByteArrayType>(rows, &[text.into()], &[1]),
            Self::TextList(text) => leaf::<ByteArrayType>(rows, &[text.into()], &[3]),
            Self::Image(files) => {
                let files: Vec<ByteArray> = files.into_iter().map(ByteArray::from).collect();
                leaf::<ByteArrayType>(rows, &files, &vec![2; files.len()])?;
                leaf::<ByteArrayType>(rows, &[], &vec![1; files.len()])
            }
        }
    }
}

/// A file that is being written.
pub(super) struct Table {
    file: SerializedFileWriter<WholeFile>,
}

impl Table {
    /// Begins a file with columns like these, and with `about` (key and value) in its end.
    pub(super) fn create(
        path: &Path,
        columns: &[(&str, Column)],
        about: Option<(&str, String)>,
    ) -> io::Result<Self> {
        let fields = columns.iter().map(|(name, column)| column.field(name));
        let fields: String = fields.collect();
        let schema = parse_message_type(&format!("message schema {{\n{fields}}}"));
        let about = about.map(|(key, value)| vec![KeyValue::new(key.to_owned(), value)]);
        let properties = WriterProperties::builder()
            // Images are unlike each other, and numbers are few.
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_created_by(String::from("smartdepthsync"))
            .set_key_value_metadata(about)
            .build();
        let file = SerializedFileWriter::new(
            WholeFile::create(path)?,
            Arc::new(schema?),
            Arc::new(properties),
        )?;
        Ok(Self { file })
    }

    /// Adds rows: columns as the file was begun with, each of equally many values.
    pub(super) fn put(&mut self, columns: Vec<(&str, Column)>) -> io::Result<()> {
        let mut rows = self.file.next_row_group()?;
        for (_, column) in columns {
            column.write(&mut rows)?;
        }
        rows.close()?;
        Ok(())
    }

    /// Finishes the file.
    pub(super) fn finish(self) -> io::Result<()> {
        self.file.into_inner()?.finish()
    }
}

/// Writes the next column; `levels` say how much of the nesting of each value is there.
fn leaf<T: DataType>(
    rows: &mut Rows<'_>,
    values: &[T::T],
    levels: &[i16],
) -> Result<(), ParquetError> {
    let column = rows.next_column()?;
    let mut column = column.ok_or_else(|| ParquetError::General("too many columns".into()))?;
    let starts = vec![0; levels.len()];
    let writer = column.typed::<T>();
    writer.write_batch(values, Some(levels), Some(&starts))?;
    column.close()
}
