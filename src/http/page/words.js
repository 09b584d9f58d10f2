// One table of words: the English text is the key. What stands in no language falls back to it.
"use strict";

const LANGUAGES = ["en", "de", "ja"];
const WORDS = {
  "API": ["API", "API"],
  "API documentation": ["API-Beschreibung", "API 文書"],
  "Token": ["Zugang", "トークン"],
  "Keys": ["Tasten", "キー"],
  "Take the turret back": ["Revolver zurückholen", "刃物台を戻す"],
  "connecting": ["verbindet", "接続中"],
  "live": ["live", "受信中"],
  "service away": ["Dienst weg", "サービス停止"],
  "machine silent": ["Maschine stumm", "機械からの信号なし"],
  "waiting": ["wartet", "待機"],
  "no data yet": ["noch keine Daten", "データなし"],
  "Quiet": ["Ruhig", "正常"],
  "no chatter": ["kein Rattern", "びびりなし"],
  "Suspected": ["Verdacht", "疑い"],
  "a line stands out of the noise": ["eine Linie ragt aus dem Rauschen", "ノイズから線が突出"],
  "CHATTER": ["RATTERN", "びびり"],
  "the cut vibrates by itself": ["der Schnitt schwingt von selbst", "切削が自励振動中"],
  "Learning": ["Lernt", "学習中"],
  "the noise of this cut is being learned": ["das Rauschen dieses Schnitts wird gelernt", "この切削のノイズを学習中"],
  "No samples": ["Keine Abtastwerte", "サンプルなし"],
  "the machine sends nothing": ["die Maschine sendet nichts", "機械が送信していません"],
  "No data": ["Keine Daten", "データなし"],
  "nothing comes from the service": ["vom Dienst kommt nichts", "サービスから受信なし"],
  "Frequency": ["Frequenz", "周波数"],
  "Line power": ["Leistung der Linie", "線の強さ"],
  "Samples lost": ["Verlorene Werte", "欠落サンプル"],
  "Mode": ["Betriebsart", "モード"],
  "Observe": ["Beobachten", "監視"],
  "watches": ["sieht zu", "監視のみ"],
  "Advise": ["Raten", "助言"],
  "shows advice": ["zeigt Rat", "助言を表示"],
  "Act": ["Handeln", "実行"],
  "moves the turret": ["bewegt den Revolver", "刃物台を動かす"],
  "Hold the turret": ["Revolver halten", "刃物台を保持"],
  "Held: let the turret go": ["Gehalten: Revolver freigeben", "保持中：解放する"],
  "Clear the fault": ["Störung quittieren", "故障を解除"],
  "Missing before act": ["Fehlt vor dem Handeln", "実行前に不足"],
  "Spectrum of the force": ["Spektrum der Kraft", "力のスペクトル"],
  "Range": ["Zeitraum", "範囲"],
  "Pitch difference": ["Teilungsunterschied", "ピッチ差"],
  "Commanded": ["Befohlen", "指令"],
  "Advised": ["Geraten", "助言値"],
  "Actual": ["Ist", "実際"],
  "Optimum": ["Optimum", "最適"],
  "Limit": ["Grenze", "限界"],
  "Cutting force": ["Schnittkraft", "切削力"],
  "Events": ["Ereignisse", "イベント"],
  "Acknowledge": ["Quittieren", "確認"],
  "Acknowledge all of these": ["Alle quittieren", "すべて確認"],
  "Silence": ["Stumm", "消音"],
  "Recordings": ["Aufzeichnungen", "記録"],
  "Save the last seconds": ["Letzte Sekunden sichern", "直近を保存"],
  "Diagnoses": ["Diagnosen", "診断"],
  "Diagnose": ["Diagnose", "診断する"],
  "Replay": ["Wiedergabe", "再生"],
  "Report": ["Bericht", "報告"],
  "Cancel": ["Abbrechen", "取消"],
  "Confirm": ["Bestätigen", "確定"],
  "Close": ["Schließen", "閉じる"],
  "Reason, for the record": ["Grund, für das Protokoll", "理由（記録用）"],
  "Minutes": ["Minuten", "分"],
  "Access token": ["Zugangstoken", "アクセストークン"],
  "The alarm was": ["Der Alarm war", "アラームは"],
  "not judged": ["nicht beurteilt", "未判定"],
  "right": ["berechtigt", "正しい"],
  "false": ["falsch", "誤報"],
  "1, 2, 3: observe, advise, act": ["1, 2, 3: beobachten, raten, handeln", "1, 2, 3：監視、助言、実行"],
  "R: take the turret back, from anywhere; Alt+R while you write": ["R: Revolver zurückholen, von überall; Alt+R beim Schreiben", "R：刃物台を戻す（どこからでも。入力中は Alt+R）"],
  "T: light or dark": ["T: hell oder dunkel", "T：明暗切替"],
  "U: mm or inch": ["U: mm oder Zoll", "U：mm／インチ"],
  "Esc: close": ["Esc: schließen", "Esc：閉じる"],
  "?: this list": ["?: diese Liste", "?：この一覧"],
  "Advice to the motion controller; not a safety function. The machine must be safe with any output of this program.": ["Rat an die Steuerung; keine Sicherheitsfunktion. Die Maschine muss mit jeder Ausgabe dieses Programms sicher sein.", "制御装置への助言であり、安全機能ではありません。本プログラムのいかなる出力でも機械は安全でなければなりません。"],
};

let language = localStorage.getItem("language") || (navigator.language || "en").slice(0, 2);
if (!LANGUAGES.includes(language)) language = "en";

// The text in the language in force.
function say(english) {
  const found = language === "en" ? null : WORDS[english.trim()];
  return found ? found[LANGUAGES.indexOf(language) - 1] : english;
}

// Says every fixed text of the page anew; each keeps its English.
function sayAll() {
  document.documentElement.lang = language;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const english = node.english || node.nodeValue.trim();
    if (!WORDS[english]) continue;
    node.english = english;
    node.nodeValue = say(english);
  }
}
