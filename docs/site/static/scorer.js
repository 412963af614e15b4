// Sphinx's weights, with pages on tasks before those that record changes and decisions.
var Scorer = {
  score: function (result) {
    var page = result[0];
    var found = result[4];
    if (/^(CHANGELOG|tests|docs\/decisions)/.test(page)) return found * 0.2;
    return /^docs\/(?!api)/.test(page) ? found * 1.5 : found;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
