"use strict";
(() => {
  const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  // Each sheet contains all views, and one view of it is visible. Pointer or arrow keys choose this
  // view.
  const look = document.getElementById("look");
  if (look) {
    const across = look.dataset.across.split("|"), up = look.dataset.up.split("|");
    let x = across.length >> 1, y = up.length >> 1;
    const show = (newX, newY) => {
      x = clamp(newX, 0, across.length - 1);
      y = clamp(newY, 0, up.length - 1);
      for (const img of look.querySelectorAll("img"))
        img.style.transform = `translate(${-100 * x / across.length}%,${-100 * y / up.length}%)`;
      look.querySelector("output").textContent = `view from ${across[x]} across, ${up[y]} up`;
    };
    const follow = (event) => {
      const sheet = event.target.closest(".sheet");
      if (!sheet) return;
      const box = sheet.getBoundingClientRect();
      show(Math.floor((event.clientX - box.left) / box.width * across.length),
           Math.floor((event.clientY - box.top) / box.height * up.length));
    };
    look.addEventListener("pointermove", follow);
    look.addEventListener("pointerdown", follow);
    look.addEventListener("keydown", (event) => {
      const step = arrows[event.key];
      if (step) { event.preventDefault(); show(x + step[0], y + step[1]); }
    });
    show(x, y);
  }

  // The slider chooses a frame. Its pictures are copied from the contact sheets of the layers.
  const frames = document.getElementById("frames");
  if (frames) {
    const sheets = [...document.querySelectorAll(".contact[data-sheet]")];
    frames.querySelector("input").addEventListener("input", (event) => {
      frames.querySelector("output").textContent = event.target.value;
      for (const place of frames.querySelectorAll("[data-sheet]")) {
        const sheet = sheets.find((sheet) => sheet.dataset.sheet === place.dataset.sheet);
        const from = sheet?.querySelector(`[data-frame="${event.target.value}"] img`);
        const to = place.querySelector("img");
        if (from) { to.src = from.src; to.alt = to.title = from.alt; }
      }
    });
  }

  // The dialog shows a picture at full size. Arrow keys step through the pictures of its group.
  const dialog = document.getElementById("zoom"), large = dialog.querySelector("img");
  let group = [], place = 0;
  const step = (by) => {
    place = (place + by + group.length) % group.length;
    const from = group[place], width = from.naturalWidth, height = from.naturalHeight;
    const room = Math.min(innerWidth * 0.98 / width, (innerHeight - 70) / height);
    large.src = from.src;
    large.alt = from.alt;
    large.style.width = `${width * Math.max(1, Math.floor(room))}px`;
    large.className = room >= 2 ? "sharp" : "";
    dialog.querySelector("output").textContent = `${from.alt} (${width} × ${height} pixels, ${place + 1} of ${group.length})`;
  };
  const open = (img) => {
    group = [...(img.closest(".group") ?? img.parentElement).querySelectorAll("img.zoom")];
    place = group.indexOf(img);
    step(0);
    dialog.showModal();
  };
  document.addEventListener("click", (event) => {
    if (event.target.matches("img.zoom")) open(event.target);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && event.target.matches?.("img.zoom")) open(event.target);
    if (dialog.open && arrows[event.key]) { event.preventDefault(); step(arrows[event.key][0] + arrows[event.key][1]); }
  });
  dialog.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (button?.dataset.step) step(Number(button.dataset.step));
    else if (event.target === large) step(1);
    else if (!button || "close" in button.dataset) dialog.close();
  });
})();
