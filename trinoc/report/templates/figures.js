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
