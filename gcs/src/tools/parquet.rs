//! Parquet files of flat tables: required columns, no compression, written by the `parquet` crate. Held against DuckDB in `tests/tests/sweep.rs`.

use std::io::Write;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use parquet::basic::{ConvertedType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};

/// Values of one column.
#[derive(Debug, Clone)]
pub enum Values<'a> {
    /// INT64
    Integers(Vec<i64>),
    /// DOUBLE
    Reals(Vec<f64>),
    /// BOOLEAN
    Booleans(Vec<bool>),
    /// BYTE_ARRAY, UTF8
    Texts(Vec<&'a str>),
}

/// A column with its name.
#[derive(Debug, Clone)]
pub struct Column<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its values; every column of a table has as many.
    pub values: Values<'a>,
}

/// Writes the table as one row group; `notes` are pairs of key and value in the file's metadata.
///
/// # Errors
/// Writing fails, or a column is of another length than the first.
pub fn write(out: impl Write + Send, columns: &[Column<'_>], notes: &[(&str, &str)]) -> Result<()> {
    let mut file = ParquetFile::new(out, columns, notes)?;
    file.push(columns)?;
    file.close()
}

/// A file that grows by row groups.
pub struct ParquetFile<W: Write + Send>(SerializedFileWriter<W>);

impl<W: Write + Send> std::fmt::Debug for ParquetFile<W> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ParquetFile")
    }
}

impl<W: Write + Send> ParquetFile<W> {
    /// A file with the columns of a table, none of whose rows are written yet.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(out: W, columns: &[Column<'_>], notes: &[(&str, &str)]) -> Result<Self> {
        let fields = columns.iter().map(Column::field).collect::<Result<Vec<_>>>()?;
        let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
        let notes = notes.iter().map(|(key, value)| KeyValue::new((*key).to_owned(), (*value).to_owned()));
        let properties = WriterProperties::builder().set_key_value_metadata(Some(notes.collect())).build();
        Ok(Self(SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties))?))
    }

    /// Appends rows as one group.
    ///
    /// # Errors
    /// Writing fails, or a column is of another length than the first.
    pub fn push(&mut self, columns: &[Column<'_>]) -> Result<()> {
        let rows = columns.first().map_or(0, |c| c.values.len());
        for column in columns {
            ensure!(column.values.len() == rows, "column {} is of another length", column.name);
        }
        let mut group = self.0.next_row_group()?;
        for column in columns {
            let mut writer = group.next_column()?.context("a column too many")?;
            column.values.write(&mut writer).with_context(|| format!("column {}", column.name))?;
            writer.close()?;
        }
        group.close()?;
        Ok(())
    }

    /// Writes the end, without which the file is none.
    ///
    /// # Errors
    /// Writing fails.
    pub fn close(self) -> Result<()> {
        self.0.close()?;
        Ok(())
    }
}

impl Column<'_> {
    fn field(&self) -> Result<TypePtr> {
        let (physical, converted) = match self.values {
            Values::Integers(_) => (Physical::INT64, ConvertedType::NONE),
            Values::Reals(_) => (Physical::DOUBLE, ConvertedType::NONE),
            Values::Booleans(_) => (Physical::BOOLEAN, ConvertedType::NONE),
            Values::Texts(_) => (Physical::BYTE_ARRAY, ConvertedType::UTF8),
        };
        let field = Type::primitive_type_builder(self.name, physical);
        let field = field.with_repetition(Repetition::REQUIRED).with_converted_type(converted);
        Ok(Arc::new(field.build()?))
    }
}

impl Values<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Integers(v) => v.len(),
            Self::Reals(v) => v.len(),
            Self::Booleans(v) => v.len(),
            Self::Texts(v) => v.len(),
        }
    }

    /// One value as text; a number that is none is empty.
    #[must_use]
    pub fn cell(&self, row: usize) -> String {
        match self {
            Self::Integers(v) => v[row].to_string(),
            Self::Reals(v) if v[row].is_nan() => String::new(),
            Self::Reals(v) => v[row].to_string(),
            Self::Booleans(v) => v[row].to_string(),
            Self::Texts(v) => v[row].to_owned(),
        }
    }

    fn write(&self, writer: &mut SerializedColumnWriter<'_>) -> Result<()> {
        match self {
            Self::Integers(v) => writer.typed::<Int64Type>().write_batch(v, None, None)?,
            Self::Reals(v) => writer.typed::<DoubleType>().write_batch(v, None, None)?,
            Self::Booleans(v) => writer.typed::<BoolType>().write_batch(v, None, None)?,
            Self::Texts(v) => {
                let texts: Vec<ByteArray> = v.iter().map(|text| ByteArray::from(*text)).collect();
                writer.typed::<ByteArrayType>().write_batch(&texts, None, None)?
            }
        };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_different_length_are_refused() {
        let columns = [
            Column { name: "a", values: Values::Integers(vec![1, 2]) },
            Column { name: "b", values: Values::Reals(vec![1.0]) },
        ];
        let error = write(Vec::new(), &columns, &[]).unwrap_err();
        assert_eq!(error.to_string(), "column b is of another length");
    }
}
