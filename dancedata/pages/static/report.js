// The report is shown, or the player of its clips: the address says which. The player starts with the first clip.
(() => {
  const html = document.documentElement;
  const body = document.body;
  const playerLink = /^#(clip|group)=/;
  let anchor = '#r-report';

  function start() {
    body.append(document.getElementById('r-clips').content.cloneNode(true));
    const back = document.createElement('a');
    back.id = 'r-back';
    back.textContent = '← Report';
    document.querySelector('[data-dd=root] .what').prepend(back);
    const script = document.createElement('script');
    script.textContent = document.getElementById('r-script').textContent;
    body.append(script);
  }

  // A link that the player was about to write would replace the report's.
  function keepAddress() {
    if (body.dataset.page === 'report' && playerLink.test(location.hash)) history.replaceState(null, '', anchor);
  }

  function show(event) {
    const clip = playerLink.test(location.hash);
    const viewer = window.dancedataViewer;
    body.dataset.page = clip ? 'clips' : 'report';
    html.classList.toggle('dd-page', clip);
    if (clip) {
      if (!viewer) start();
      document.getElementById('r-back').href = anchor;
      return;
    }
    anchor = location.hash || '#r-report';
    if (event) event.stopImmediatePropagation();
    if (viewer?.state.playing) viewer.play(false);
    setTimeout(keepAddress, 400);
    const place = document.getElementById(location.hash.slice(1));
    if (place) place.scrollIntoView();
  }

  // Back from a clip to the place where its name was clicked.
  document.getElementById('r-report').addEventListener('click', event => {
    const link = event.target.closest('a[href^="#clip="], a[href^="#group="]');
    const section = link?.closest('figure[id], section');
    const heading = section && (section.id ? section : section.querySelector('h2'));
    if (heading) anchor = `#${heading.id}`;
  });
  window.addEventListener('hashchange', show);
  show();
})();
