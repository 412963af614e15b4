// Tables that are sorted by the column whose head is pressed: numbers by value, then texts, then dashes.
(() => {
  const RANKS = { number: 0, string: 1, undefined: 2 };

  // A dash has no value.
  const cellValue = text => {
    if (text === '–') return undefined;
    const number = Number.parseFloat(text.replace(/−/g, '-').replace(/,/g, ''));
    return Number.isNaN(number) ? text : number;
  };

  // Texts among numbers, and cells without a value, come last in both directions.
  function compare(a, b, down) {
    if (typeof a !== typeof b) return RANKS[typeof a] - RANKS[typeof b];
    const order = a < b ? -1 : a > b ? 1 : 0;
    return down ? -order : order;
  }

  function sortBy(table, column, down) {
    const body = table.tBodies[0];
    const keyed = [...body.rows].map(row => [cellValue(row.cells[column].textContent.trim()), row]);
    keyed.sort(([a], [b]) => compare(a, b, down));
    body.append(...keyed.map(([, row]) => row));
    [...table.tHead.rows[0].cells].forEach((cell, k) => {
      if (k === column) cell.setAttribute('aria-sort', down ? 'descending' : 'ascending');
      else cell.removeAttribute('aria-sort');
    });
  }

  for (const table of document.querySelectorAll('#r-report table.sortable')) {
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      const button = document.createElement('button');
      button.type = 'button';
      button.textContent = cell.textContent;
      button.addEventListener('click', () => sortBy(table, column, cell.getAttribute('aria-sort') === 'ascending'));
      cell.replaceChildren(button);
    });
  }
})();
