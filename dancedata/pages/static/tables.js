// Tables that are sorted by the column whose head is pressed: numbers by value, the rest as text.
(() => {
  const cellValue = text => {
    const number = Number.parseFloat(text.replace(/−/g, '-').replace(/,/g, ''));
    return Number.isNaN(number) ? text : number;
  };

  function compare(a, b) {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === 'number' ? -1 : 1;
  }

  function sortBy(table, column, down) {
    const body = table.tBodies[0];
    const keyed = [...body.rows].map(row => [cellValue(row.cells[column].textContent.trim()), row]);
    keyed.sort(([a], [b]) => (down ? compare(b, a) : compare(a, b)));
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
