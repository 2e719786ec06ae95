// Overrides as one types them.

/** Words of a line, where quotation marks and brackets keep spaces in a word, as keys of TOML have them. */
export function words(line: string): string[] {
  const found: string[] = [];
  let word = "";
  let depth = 0;
  let quote = "";
  for (const each of line) {
    if (quote) quote = each === quote ? "" : quote;
    else if (each === '"' || each === "'") quote = each;
    else if ("[{".includes(each)) depth++;
    else if ("]}".includes(each)) depth--;
    if (/\s/.test(each) && !quote && depth <= 0) {
      if (word) found.push(word);
      word = "";
    } else word += each;
  }
  return word ? [...found, word] : found;
}
