// Zoom of the pictures: by the wheel about the pointer, by the buttons and keys about the centre.
(function () {
  function measure(box) {
    const img = box.querySelector("img");
    if (img && img.naturalWidth) box.style.setProperty("--zoom", img.clientWidth / img.naturalWidth);
  }
  function fit(box) {
    const img = box.querySelector("img"), canvas = box.querySelector(".frame-canvas");
    if (!img || !img.naturalWidth || !canvas) return;
    // A tall picture is fitted by its height.
    const most = 0.7 * window.innerHeight * (img.naturalWidth / img.naturalHeight);
    canvas.style.width = "min(100cqi - 2px, " + most + "px)";
    measure(box);
  }
  // Another size of the picture is that of another recording.
  function fitNew(box) {
    const img = box.querySelector("img");
    const size = img && img.naturalWidth ? img.naturalWidth + "x" + img.naturalHeight : "";
    if (size && box.dataset.size !== size) {
      box.dataset.size = size;
      fit(box);
    } else {
      measure(box);
    }
  }
  function zoom(box, factor, x, y) {
    const canvas = box.querySelector(".frame-canvas"), img = box.querySelector("img");
    if (!img || !img.naturalWidth) return;
    if (factor === 0) {
      fit(box);
    } else {
      const before = img.clientWidth;
      const width = Math.min(Math.max(before * factor, 40), img.naturalWidth * 40);
      const left = box.scrollLeft + x, top = box.scrollTop + y;
      canvas.style.width = width + "px";
      box.scrollLeft = (left * width) / before - x;
      box.scrollTop = (top * width) / before - y;
    }
    measure(box);
  }
  window.zoomFrame = function (factor) {
    const box = document.querySelector(".frame-box");
    if (box) zoom(box, factor, box.clientWidth / 2, box.clientHeight / 2);
  };
  document.addEventListener("wheel", function (event) {
    const box = event.target.closest && event.target.closest(".frame-box");
    if (!box) return;
    event.preventDefault();
    const place = box.getBoundingClientRect();
    zoom(box, event.deltaY < 0 ? 1.25 : 0.8, event.clientX - place.left, event.clientY - place.top);
  }, { passive: false });
  document.addEventListener("keydown", function (event) {
    const box = event.target;
    if (!box.classList || !box.classList.contains("frame-box")) return;
    const factor = { "+": 1.25, "=": 1.25, "-": 0.8, "0": 0 }[event.key];
    if (factor === undefined) return;
    event.preventDefault();
    zoom(box, factor, box.clientWidth / 2, box.clientHeight / 2);
  });
  function all() {
    document.querySelectorAll(".frame-box").forEach(fitNew);
    document.querySelectorAll(".frame-image img:not([alt])").forEach((img) => (img.alt = "Frame of the recording"));
  }
  document.addEventListener("load", all, true);
  window.addEventListener("resize", all);
  new MutationObserver(all).observe(document, { childList: true, subtree: true });
})();
