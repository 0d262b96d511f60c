// Names of the marks on the time axis: their texts, and places in rows above the plot.

export const ROWS = 2;
const RANK = { trip: 0, start: 1, end: 1, note: 2 }; // the first gets its place first
const MOST_LETTERS = 40; // of a name
const GAP = 8; // between the line and its name, and between two names, in characters' tenths

// Return the text of a mark: a note's text, or the kind.
export const markText = ({ kind, text }) => text || kind;

// Return the names that have a place, as {text, x, row, kind}, x at their left. `widthOf` returns the
// width of a text, and `at` the place of a mark, in the unit of `width`. A note without enough space
// is cut; a name without any space is left out, and the cursor shows it.
export function placedNames(marks, { width, at, widthOf }) {
  const gap = widthOf("x") * (GAP / 10);
  const least = widthOf("xxx…");
  const rows = Array.from({ length: ROWS }, () => []);
  const placed = [];
  const ranked = marks.map((mark) => ({ ...mark, x: at(mark.x) })).filter(({ x }) => x >= 0 && x <= width);
  for (const mark of ranked.sort((a, b) => RANK[a.kind] - RANK[b.kind] || a.x - b.x)) {
    const name = cut(markText(mark), widthOf("x") * MOST_LETTERS, widthOf);
    const wanted = widthOf(name);
    // A name over the line of another mark may leave no place for that mark's name.
    const covered = ({ x }) => ranked.filter((other) => other !== mark && other.x > x && other.x < x + wanted).length;
    const places = rows.flatMap((taken, row) => {
      const from = Math.max(0, ...taken.filter(([begin]) => begin <= mark.x).map(([, end]) => end + gap));
      const to = Math.min(width, ...taken.filter(([begin]) => begin > mark.x).map(([begin]) => begin - gap));
      const right = { row, x: mark.x + gap / 2, space: to - mark.x - gap / 2 };
      const left = { row, x: Math.max(from, mark.x - gap / 2 - wanted), space: mark.x - gap / 2 - from };
      return from > mark.x + gap / 2 ? [] : [right, left];
    });
    const fitting = places.filter(({ space }) => space >= wanted).sort((a, b) => covered(a) - covered(b));
    const place = fitting[0] ?? places.sort((a, b) => b.space - a.space)[0];
    if (!place || (place.space < wanted && (mark.kind !== "note" || place.space < least))) continue;
    const text = cut(name, place.space, widthOf);
    placed.push({ text, x: place.x, row: place.row, kind: mark.kind });
    rows[place.row].push([place.x, place.x + Math.min(wanted, place.space)]);
  }
  return placed;
}

// Return the longest beginning of a text that has space.
function cut(text, space, widthOf) {
  if (widthOf(text) <= space) return text;
  let length = Math.floor((text.length * space) / widthOf(text));
  while (length > 1 && widthOf(`${text.slice(0, length)}…`) > space) length -= 1;
  return `${text.slice(0, length)}…`;
}

// Return the text of the mark that is nearest to x, if it is within `reach`; otherwise "".
export function textNear(marks, x, reach) {
  const near = marks.filter((mark) => Math.abs(mark.x - x) <= reach);
  return near.map((mark) => (mark.kind === "note" ? `note: ${mark.text}` : mark.kind)).join("; ");
}
