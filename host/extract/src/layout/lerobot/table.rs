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

/// What a column holds.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Int,
    Float,
    Double,
    Text,
    /// Lists of one text each.
    TextList,
    /// Files of images, as Hugging Face's `Image` has them: `bytes`, and a `path` that is
    /// not there.
    Image,
}

/// Values of a column.
#[derive(Clone, Debug)]
pub(super) enum Values {
    Int(Vec<i64>),
    Float(Vec<f32>),
    Double(Vec<f64>),
    /// Of texts, lists and images.
    Bytes(Vec<Vec<u8>>),
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Self::Int(values) => values.len(),
            Self::Float(values) => values.len(),
            Self::Double(values) => values.len(),
            Self::Bytes(values) => values.len(),
        }
    }

    pub(super) fn text(text: &str) -> Self {
        Self::Bytes(vec![text.as_bytes().to_vec()])
    }
}

/// A file that is being written.
pub(super) struct Table {
    kinds: Vec<Kind>,
    file: SerializedFileWriter<WholeFile>,
}

impl Table {
    /// Begins a file with these columns, and with `about` (key and value) in its end.
    pub(super) fn create(
        path: &Path,
        columns: &[(String, Kind)],
        about: Option<(&str, String)>,
    ) -> io::Result<Self> {
        let fields: String = columns
            .iter()
            .map(|(name, kind)| match kind {
                Kind::Int => format!("optional int64 {name};\n"),
                Kind::Float => format!("optional float {name};\n"),
                Kind::Double => format!("optional double {name};\n"),
                Kind::Text => format!("optional binary {name} (STRING);\n"),
                Kind::TextList => format!(
                    "optional group {name} (LIST) {{ repeated group list {{ \
                     optional binary element (STRING); }} }}\n"
                ),
                Kind::Image => format!(
                    "optional group {name} {{ optional binary bytes; \
                     optional binary path (STRING); }}\n"
                ),
            })
            .collect();
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
            Arc::new(schema.map_err(failed)?),
            Arc::new(properties),
        );
        Ok(Self {
            kinds: columns.iter().map(|&(_, kind)| kind).collect(),
            file: file.map_err(failed)?,
        })
    }

    /// Adds rows: the values of each column, in order and equally many.
    pub(super) fn put(&mut self, columns: Vec<Values>) -> io::Result<()> {
        self.put_rows(columns).map_err(failed)
    }

    fn put_rows(&mut self, columns: Vec<Values>) -> Result<(), ParquetError> {
        let mut rows = self.file.next_row_group()?;
        for (&kind, values) in self.kinds.iter().zip(columns) {
            // How much of the nesting is there: all of it.
            let level = match kind {
                Kind::Int | Kind::Float | Kind::Double | Kind::Text => 1,
                Kind::TextList => 3,
                Kind::Image => 2,
            };
            let levels = vec![level; values.len()];
            let starts = vec![0; values.len()];
            let levels = (levels.as_slice(), starts.as_slice());
            match values {
                Values::Int(values) => leaf::<Int64Type>(&mut rows, &values, levels)?,
                Values::Float(values) => leaf::<FloatType>(&mut rows, &values, levels)?,
                Values::Double(values) => leaf::<DoubleType>(&mut rows, &values, levels)?,
                Values::Bytes(values) => {
                    let values: Vec<ByteArray> = values.into_iter().map(ByteArray::from).collect();
                    leaf::<ByteArrayType>(&mut rows, &values, levels)?;
                }
            }
            if matches!(kind, Kind::Image) {
                // Images are there and their paths are not.
                let levels = vec![1; levels.0.len()];
                leaf::<ByteArrayType>(&mut rows, &[], (&levels, &starts))?;
            }
        }
        rows.close()?;
        Ok(())
    }

    /// Finishes the file.
    pub(super) fn finish(self) -> io::Result<()> {
        self.file.into_inner().map_err(failed)?.finish()
    }
}

/// Writes the next column; `levels` are definition and repetition of each value.
fn leaf<T: DataType>(
    rows: &mut SerializedRowGroupWriter<'_, WholeFile>,
    values: &[T::T],
    (levels, starts): (&[i16], &[i16]),
) -> Result<(), ParquetError> {
    let column = rows.next_column()?;
    let mut column = column.ok_or_else(|| ParquetError::General("too many columns".into()))?;
    let writer = column.typed::<T>();
    writer.write_batch(values, Some(levels), Some(starts))?;
    column.close()
}

fn failed(error: ParquetError) -> io::Error {
    io::Error::other(error)
}
