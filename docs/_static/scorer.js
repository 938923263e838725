// Scores of results of the search: words that docs/words.md lists count most, then titles and text, then objects of the
// reference, which are many.
var Scorer = {
  objNameMatch: 3,
  objPartialMatch: 1,
  objPrio: { 0: 3, 1: 2, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
  // The list of changes, and pages for those who change the package, have nearly every word.
  score: ([docname, , , , score]) => (/^(CHANGELOG|CONTRIBUTING|requirements)/.test(docname) ? score / 3 : score),
};
