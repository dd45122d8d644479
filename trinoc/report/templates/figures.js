document.querySelectorAll(".enlarge").forEach((button) => {
  button.addEventListener("click", () => {
    const large = button.closest("figure").classList.toggle("large");
    button.textContent = large ? "reduce" : "enlarge";
  });
});

document.querySelectorAll(".dimmer input").forEach((input) => {
  input.addEventListener("input", () => {
    document.documentElement.style.setProperty("--strength", input.value / 100);
  });
});

document.querySelectorAll(".levels").forEach((block) => {
  const input = block.querySelector("input");
  const levels = [...block.querySelectorAll("[data-said]")];
  const show = () => {
    levels.forEach((level, at) => level.classList.toggle("away", at !== Number(input.value)));
    block.querySelector("output").textContent = levels[input.value].dataset.said;
  };
  input.addEventListener("input", show);
  show();
});
