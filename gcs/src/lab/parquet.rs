//! Parquet files of flat tables: required columns, plain encoding, no compression.
//!
//! The `parquet` crate would do more than is needed here, and it turns on a feature of a crate that
//! burn is built on, so that everything built on burn would have to be compiled once for `-p model`
//! and once for `--workspace`. The format's document is <https://parquet.apache.org/docs/file-format/>;
//! the metadata is in Thrift's compact protocol. Held against DuckDB in `tests/tests/sweep.rs`.

use std::io::{self, Write};

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

/// First and last four bytes of a file.
const MAGIC: &[u8; 4] = b"PAR1";

/// Types of the Thrift compact protocol.
mod thrift {
    pub const I32: u8 = 5;
    pub const I64: u8 = 6;
    pub const BINARY: u8 = 8;
    pub const LIST: u8 = 9;
    pub const STRUCT: u8 = 12;
}

/// Writes the table as one row group; `notes` are pairs of key and value in the file's metadata.
///
/// # Errors
/// If writing fails, or if a column is of another length or above 2 GiB.
pub fn write(out: &mut impl Write, columns: &[Column<'_>], notes: &[(&str, &str)]) -> io::Result<()> {
    let rows = columns.first().map_or(0, |c| c.values.len());
    out.write_all(MAGIC)?;
    let mut offset = MAGIC.len();
    let mut chunks = Vec::new();
    for column in columns {
        if column.values.len() != rows {
            return Err(io::Error::other(format!("column {} is of another length", column.name)));
        }
        let body = column.values.plain();
        let header = page_header(rows, body.len())?;
        out.write_all(&header)?;
        out.write_all(&body)?;
        let bytes = header.len() + body.len();
        chunks.push(chunk(column, rows, offset, bytes));
        offset += bytes;
    }
    let footer = footer(columns, rows, offset - MAGIC.len(), &chunks, notes);
    out.write_all(&footer)?;
    out.write_all(&(footer.len() as u32).to_le_bytes())?;
    out.write_all(MAGIC)
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

    /// Number of the physical type.
    fn physical_type(&self) -> i64 {
        match self {
            Self::Booleans(_) => 0,
            Self::Integers(_) => 2,
            Self::Reals(_) => 5,
            Self::Texts(_) => 6,
        }
    }

    /// PLAIN encoding.
    fn plain(&self) -> Vec<u8> {
        match self {
            Self::Integers(v) => v.iter().flat_map(|x| x.to_le_bytes()).collect(),
            Self::Reals(v) => v.iter().flat_map(|x| x.to_le_bytes()).collect(),
            Self::Booleans(v) => v
                .chunks(8)
                .map(|bits| bits.iter().enumerate().fold(0, |byte, (n, bit)| byte | (u8::from(*bit) << n)))
                .collect(),
            Self::Texts(v) => {
                let framed = v.iter().flat_map(|text| {
                    (text.len() as u32).to_le_bytes().into_iter().chain(text.as_bytes().iter().copied())
                });
                framed.collect()
            }
        }
    }
}

/// PageHeader of a data page.
fn page_header(rows: usize, body: usize) -> io::Result<Vec<u8>> {
    let size = i32::try_from(body).map_err(|_| io::Error::other("a column above 2 GiB"))?;
    let mut header = Struct::default();
    header.int(1, thrift::I32, 0); // DATA_PAGE
    header.int(2, thrift::I32, size.into());
    header.int(3, thrift::I32, size.into());
    let mut data = Struct::default();
    data.int(1, thrift::I32, rows as i64);
    data.int(2, thrift::I32, 0); // values are PLAIN
    data.int(3, thrift::I32, 3); // levels are RLE, and there are none
    data.int(4, thrift::I32, 3);
    header.structure(5, data);
    Ok(header.end())
}

/// ColumnChunk with its ColumnMetaData.
fn chunk(column: &Column<'_>, rows: usize, offset: usize, bytes: usize) -> Vec<u8> {
    let mut meta = Struct::default();
    meta.int(1, thrift::I32, column.values.physical_type());
    meta.list(2, thrift::I32, &[zigzag(0)]); // PLAIN
    meta.list(3, thrift::BINARY, &[binary(column.name)]);
    meta.int(4, thrift::I32, 0); // uncompressed
    meta.int(5, thrift::I64, rows as i64);
    meta.int(6, thrift::I64, bytes as i64);
    meta.int(7, thrift::I64, bytes as i64);
    meta.int(9, thrift::I64, offset as i64);
    let mut chunk = Struct::default();
    chunk.int(2, thrift::I64, offset as i64);
    chunk.structure(3, meta);
    chunk.end()
}

/// FileMetaData.
fn footer(
    columns: &[Column<'_>],
    rows: usize,
    bytes: usize,
    chunks: &[Vec<u8>],
    notes: &[(&str, &str)],
) -> Vec<u8> {
    let mut root = Struct::default();
    root.binary(4, "table");
    root.int(5, thrift::I32, columns.len() as i64);
    let mut schema = vec![root.end()];
    schema.extend(columns.iter().map(|column| {
        let mut element = Struct::default();
        element.int(1, thrift::I32, column.values.physical_type());
        element.int(3, thrift::I32, 0); // required
        element.binary(4, column.name);
        if matches!(column.values, Values::Texts(_)) {
            element.int(6, thrift::I32, 0); // UTF8
        }
        element.end()
    }));

    let mut group = Struct::default();
    group.list(1, thrift::STRUCT, chunks);
    group.int(2, thrift::I64, bytes as i64);
    group.int(3, thrift::I64, rows as i64);

    let pairs: Vec<Vec<u8>> = notes
        .iter()
        .map(|(key, value)| {
            let mut pair = Struct::default();
            pair.binary(1, key);
            pair.binary(2, value);
            pair.end()
        })
        .collect();

    let mut file = Struct::default();
    file.int(1, thrift::I32, 1);
    file.list(2, thrift::STRUCT, &schema);
    file.int(3, thrift::I64, rows as i64);
    file.list(4, thrift::STRUCT, &[group.end()]);
    file.list(5, thrift::STRUCT, &pairs);
    file.binary(6, concat!("crpl gcs ", env!("CARGO_PKG_VERSION")));
    file.end()
}

/// A Thrift struct in the compact protocol, fields in ascending order.
#[derive(Debug, Default)]
struct Struct {
    bytes: Vec<u8>,
    last: u8,
}

impl Struct {
    fn field(&mut self, id: u8, of: u8) {
        // Ids here are close to each other: the short form always fits.
        self.bytes.push(((id - self.last) << 4) | of);
        self.last = id;
    }

    fn int(&mut self, id: u8, of: u8, value: i64) {
        self.field(id, of);
        self.bytes.extend(zigzag(value));
    }

    fn binary(&mut self, id: u8, text: &str) {
        self.field(id, thrift::BINARY);
        self.bytes.extend(binary(text));
    }

    fn structure(&mut self, id: u8, inner: Self) {
        self.field(id, thrift::STRUCT);
        self.bytes.extend(inner.end());
    }

    fn list(&mut self, id: u8, of: u8, items: &[Vec<u8>]) {
        self.field(id, thrift::LIST);
        match items.len() {
            short @ 0..15 => self.bytes.push(((short as u8) << 4) | of),
            long => {
                self.bytes.push(0xf0 | of);
                self.bytes.extend(varint(long as u64));
            }
        }
        self.bytes.extend(items.iter().flatten());
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

fn varint(mut n: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while n >= 0x80 {
        bytes.push(n as u8 | 0x80);
        n >>= 7;
    }
    bytes.push(n as u8);
    bytes
}

fn zigzag(n: i64) -> Vec<u8> {
    varint(((n << 1) ^ (n >> 63)) as u64)
}

fn binary(text: &str) -> Vec<u8> {
    let mut bytes = varint(text.len() as u64);
    bytes.extend(text.as_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_compact_protocol() {
        // The examples of Thrift's own specification.
        assert_eq!(varint(50_399), [0xdf, 0x89, 0x03]);
        assert_eq!([zigzag(0), zigzag(-1), zigzag(1), zigzag(-2)], [[0], [1], [2], [3]]);
    }

    #[test]
    fn columns_of_different_length_are_refused() {
        let columns = [
            Column { name: "a", values: Values::Integers(vec![1, 2]) },
            Column { name: "b", values: Values::Reals(vec![1.0]) },
        ];
        let error = write(&mut Vec::new(), &columns, &[]).unwrap_err();
        assert_eq!(error.to_string(), "column b is of another length");
    }

    #[test]
    fn booleans_are_packed_from_the_lowest_bit() {
        let bits = [true, false, false, true, false, false, false, false, true];
        assert_eq!(Values::Booleans(bits.to_vec()).plain(), [0b1001, 1]);
    }
}
