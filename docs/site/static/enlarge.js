// A picture is shown at its size, over the page, after a click or Enter; Escape or another click closes it.
const shown = document.createElement('dialog');
shown.className = 'enlarged';
shown.setAttribute('aria-label', 'Enlarged picture');
shown.addEventListener('click', () => shown.close());
document.body.append(shown);
for (const picture of document.querySelectorAll('article img')) {
  if (picture.closest('a')) continue;
  const open = () => {
    const large = picture.cloneNode();
    large.removeAttribute('tabindex');
    large.removeAttribute('role');
    shown.replaceChildren(large);
    shown.showModal();
  };
  picture.tabIndex = 0;
  picture.setAttribute('role', 'button');
  picture.title = 'Enlarge';
  picture.addEventListener('click', open);
  picture.addEventListener('keydown', event => {
    if (event.key === 'Enter') open();
  });
}
